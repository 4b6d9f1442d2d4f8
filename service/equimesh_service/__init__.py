"""The equimesh REST service."""
