"""Meshes that follow a solution in time, with the fields that are carried along."""
