"""One round of adapting: from the nodal values of a solver on a mesh to the next mesh."""
