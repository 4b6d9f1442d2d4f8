"""One mesh in parts: strips of rows, which several processes may hold."""
