"""The equimesh REST service: :func:`run` serves, :func:`running` serves for the length of a ``with``."""

from equimesh_service.server import run, running
from equimesh_service.settings import Settings

__all__ = ["Settings", "run", "running"]
