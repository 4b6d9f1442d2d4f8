"""Local equidistribution of 2D meshes by Schwarz domain decomposition."""
