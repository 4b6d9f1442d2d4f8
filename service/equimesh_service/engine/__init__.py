"""Engines, which run tasks: one interface, with a pool of processes and a Dask cluster behind it."""
