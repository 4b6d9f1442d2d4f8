"""What is checked of a request before its mesh may wait."""
