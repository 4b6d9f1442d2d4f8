"""What is requested of the service, as values."""
