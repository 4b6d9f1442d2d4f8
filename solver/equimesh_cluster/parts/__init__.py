"""One mesh in parts, strips of rows, each of which another process may hold."""
