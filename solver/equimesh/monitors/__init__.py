"""Monitor functions: the metrics that a mesh equidistributes."""
