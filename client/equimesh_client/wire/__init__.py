"""Between a request and its answer."""
