"""The operations of the OpenAPI document, and the routes of the application."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from starlette.routing import BaseRoute, Route


def operations(document: dict[str, Any]) -> list[tuple[str, str, dict[str, Any]]]:
    return [(m.upper(), path, op) for path, methods in document["paths"].items() for m, op in methods.items()]


def walk(routes: Iterable[BaseRoute]) -> Iterator[tuple[str, str]]:
    """Every method and path of an application, those that its document leaves out, too."""
    for route in routes:
        inner = getattr(route, "original_router", None)  # FastAPI keeps the routers that an application includes
        if inner is not None:
            yield from walk(inner.routes)
        elif isinstance(route, Route):
            yield from ((method, route.path) for method in sorted(route.methods or ()))
        else:
            raise AssertionError(f"{route!r} is no plain route: the tests of all routes do not know it")
