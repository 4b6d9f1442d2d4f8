"""Node positions that minimise the measured interpolation error of u."""
