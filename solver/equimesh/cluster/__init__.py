"""One mesh, or one Schwarz iteration, on the workers of a Dask cluster."""
