"""Conformance kits: each takes an implementation of a port, and raises :class:`AssertionError` for a broken promise.

``GEOMETRIES`` are ten domains of blocks for tests and benchmarks.
"""

from equimesh.testing.domains import check_domain
from equimesh.testing.fields import check_field
from equimesh.testing.geometries import GEOMETRIES
from equimesh.testing.monitors import check_monitor
from equimesh.testing.transmission import check_transmission

__all__ = ["GEOMETRIES", "check_domain", "check_field", "check_monitor", "check_transmission"]
