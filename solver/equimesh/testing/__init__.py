"""Conformance kits: each takes an implementation of a port, and raises :class:`AssertionError` for a broken promise."""

from equimesh.testing.domains import check_domain
from equimesh.testing.fields import check_field
from equimesh.testing.monitors import check_monitor
from equimesh.testing.transmission import check_transmission

__all__ = ["check_domain", "check_field", "check_monitor", "check_transmission"]
