"""One module for each library: the mesh as that library has it, and its solution in our order of the nodes."""
