"""Errors over the wire: one table of problems."""
