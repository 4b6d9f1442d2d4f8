"""Conformance kits: each takes an implementation of a port, and raises :class:`AssertionError` for a broken promise.

``GEOMETRIES`` are ten domains of blocks for tests and benchmarks.
"""

from equimesh.testing.checks import check_domain, check_field, check_monitor, check_transmission
from equimesh.testing.geometries import GEOMETRIES

__all__ = ["GEOMETRIES", "check_domain", "check_field", "check_monitor", "check_transmission"]
