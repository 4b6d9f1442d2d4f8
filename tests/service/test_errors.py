"""The tree of exceptions in the docstring of ``errors`` is the tree of the classes that exist."""

from __future__ import annotations

import pkgutil
import re
from importlib import import_module

import equimesh_service
from equimesh_service import errors

_OTHERS = ("equimesh_service.store.migrations",)  # alembic alone can import these


def existing() -> dict[str, str]:
    """Every exception class that a module of the service defines, and its base there."""
    found: dict[str, str] = {}
    for info in pkgutil.walk_packages(equimesh_service.__path__, "equimesh_service."):
        if info.name.startswith(_OTHERS):
            continue
        for thing in vars(import_module(info.name)).values():
            if isinstance(thing, type) and issubclass(thing, BaseException) and thing.__module__ == info.name:
                found[thing.__name__] = thing.__bases__[0].__name__
    return found


def drawn() -> dict[str, str]:
    """Every class of the drawing, and its base there."""
    found: dict[str, str] = {}
    above: list[str] = []
    for line in (errors.__doc__ or "").splitlines():
        entry = re.match(r"    ((?:[│ ]   )*)(?:[├└]── )?([A-Z]\w+)\b", line)
        if entry is None:
            continue
        depth = len(entry[1]) // 4 + ("── " in line)
        found[entry[2]] = above[depth - 1] if depth else "Exception"
        above[depth:] = [entry[2]]
    return found


def test_the_drawn_tree_is_the_tree_that_exists() -> None:
    assert drawn() == existing()
    assert drawn()["NewerDatabaseError"] == "UnusableDatabaseError"
