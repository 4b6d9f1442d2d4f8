"""The parts of a request, as values."""
