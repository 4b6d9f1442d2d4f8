"""The result of one check of an installation."""

from dataclasses import dataclass
from enum import StrEnum


class Level(StrEnum):
    """How bad a finding is: the service works, works with a fault, or does not work."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A finding: its level, a ``message`` for the user, and the remedy."""

    level: Level
    message: str
    remedy: str = ""


def ok(message: str) -> Finding:
    """A finding without anything to do."""
    return Finding(level=Level.OK, message=message)


def warning(message: str, remedy: str) -> Finding:
    """A finding that should be mended, although the service works."""
    return Finding(level=Level.WARNING, message=message, remedy=remedy)


def failed(message: str, remedy: str = "") -> Finding:
    """A finding with which the service does not work; ``message`` may hold the remedy itself."""
    return Finding(level=Level.FAILED, message=message, remedy=remedy)
