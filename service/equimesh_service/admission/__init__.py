"""The checks of a request before its mesh is stored."""
