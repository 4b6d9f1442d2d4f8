"""What a check of an installation found."""

from dataclasses import dataclass
from enum import StrEnum


class Level(StrEnum):
    """How bad it is: a service works, works not as it should, or does not work."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What was found, and what to do about it."""

    level: Level
    said: str
    remedy: str = ""


def ok(said: str) -> Finding:
    """Nothing to do."""
    return Finding(level=Level.OK, said=said)


def warning(said: str, remedy: str) -> Finding:
    """It works, and there is something to do."""
    return Finding(level=Level.WARNING, said=said, remedy=remedy)


def failed(said: str, remedy: str = "") -> Finding:
    """It does not work until something is done; the remedy may stand in ``said`` itself."""
    return Finding(level=Level.FAILED, said=said, remedy=remedy)
