"""What the service reports, as values."""
