"""Gradient maps: meshes whose cells have equal shares of a density, by the equation of Monge and Ampere."""
