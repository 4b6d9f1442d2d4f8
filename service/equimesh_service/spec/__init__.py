"""Strict models of what clients send."""
