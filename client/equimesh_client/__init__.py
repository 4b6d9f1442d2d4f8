"""Python client of the equimesh service."""
