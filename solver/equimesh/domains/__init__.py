"""Images of the unit square: the physical domains, and the curves that bound them."""
