"""The versions that service and workers of a cluster have in common: jobs and results are pickles."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

_PACKAGES = ("equimesh", "distributed", "cloudpickle", "numpy")
# Of these, releases with the same first two numbers read each other's pickles.
_BY_TWO_NUMBERS = ("Python", "numpy")
_MISSING = "none"


def versions() -> dict[str, str]:
    """The versions in this process, by name."""
    return {"Python": platform.python_version(), **{name: _version(name) for name in _PACKAGES}}


def describe_difference(here: Mapping[str, str], there: Mapping[str, str]) -> str:
    """In what a worker ``there`` differs from ``here``, as words; "" where it does not."""
    different = [name for name in here if _relevant(name, here) != _relevant(name, there)]
    return ", ".join(f"{name} {there.get(name, _MISSING)} in place of {here[name]}" for name in different)


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return _MISSING


def _relevant(name: str, found: Mapping[str, str]) -> str:
    text = found.get(name, _MISSING)
    return ".".join(text.split(".")[:2]) if name in _BY_TWO_NUMBERS else text
