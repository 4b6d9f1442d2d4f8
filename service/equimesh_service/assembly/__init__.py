"""From a spec to the objects of the solver."""
