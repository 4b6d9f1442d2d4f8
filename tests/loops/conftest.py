"""Loops around solvers use the services and the clients that other tests use."""

from client.conftest import connect
from service.conftest import settings, url

__all__ = ["connect", "settings", "url"]
