"""Fields from one mesh to another: by splines, or with their integrals."""
