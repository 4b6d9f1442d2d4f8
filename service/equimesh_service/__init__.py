"""The equimesh REST service: :func:`run` serves in the foreground, :func:`running` for the length of a ``with``."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from equimesh_service.settings import Settings

if TYPE_CHECKING:
    from equimesh.compiling import Line

__all__ = ["Settings", "run", "running"]


# The server is imported late, so that the settings load without FastAPI, SQLAlchemy and the solver.
def run(settings: Settings) -> None:
    """Serve until the process gets SIGINT or SIGTERM; see :func:`equimesh_service.server.run`."""
    from equimesh_service import server

    server.run(settings)


def running(settings: Settings, *, line: Line | None = None) -> AbstractContextManager[str]:
    """A service in a thread of this process, for the length of a ``with``; see :func:`equimesh_service.server.running`.

    Gives the URL of the service.
    """
    from equimesh_service import server

    return server.running(settings, line=line)
