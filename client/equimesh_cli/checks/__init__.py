"""What `equimesh doctor` examines."""
