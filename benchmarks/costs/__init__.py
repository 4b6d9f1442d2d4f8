"""What meshes cost, measured: the parts of several benchmarks."""
