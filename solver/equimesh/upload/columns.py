"""Which columns of a table, or arrays of a file, are x, y and u; and how much of a file is read."""

from __future__ import annotations

import sys
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

from equimesh.errors import SamplesError

# The limits of a file of samples: reading stops where one is exceeded.

# The most lines without a sample in a csv file whose number of samples is limited, besides one for each sample.
MAX_OTHER_LINES: Final = 10_000
# The most sections and arrays of a legacy vtk file.
MAX_SECTIONS: Final = 10_000
# The most columns of a csv file.
MAX_COLUMNS: Final = 1000
# The most values of a json file besides those of its samples.
_MAX_OTHER_VALUES: Final = 10_000
# The values of one scattered sample in a json file: x, y, u, and the list of the point.
_VALUES_OF_SAMPLE: Final = 4
# The most bytes of the numbers of one sample in one array: x and y.
_BYTES_OF_SAMPLE: Final = 16
# The most bytes of the header of an npy file.
_HEADER_BYTES: Final = 65_536


@dataclass(frozen=True, kw_only=True)
class Limits:
    """The most bytes of the arrays of a file when they are unpacked, and the most samples."""

    max_bytes: int
    max_samples: int = sys.maxsize

    @property
    def max_lines(self) -> int:
        """The most lines of a csv file."""
        return 2 * self.max_samples + MAX_OTHER_LINES

    @property
    def max_values(self) -> int:
        """The most values of a json file."""
        return _VALUES_OF_SAMPLE * self.max_samples + _MAX_OTHER_VALUES

    @property
    def max_npy_bytes(self) -> int:
        """The most bytes of an npy file: one with more has too many samples, whatever the type of its numbers."""
        return _BYTES_OF_SAMPLE * self.max_samples + _HEADER_BYTES

    def check(self, number: int, most: int | None = None) -> None:
        """Raise :class:`~equimesh.errors.SamplesError` for more than ``most``: ``max_samples``, unless it is given."""
        if number > (self.max_samples if most is None else most):
            raise SamplesError(f"the file has more than {self.max_samples} samples, the limit: send fewer")


MATRIX: Final = "matrix"
"""The choice that takes a table without a header as a matrix of values."""
# The names of coordinates, without case, as ParaView and others write them.
_COORDINATES: Final = tuple(
    frozenset((axis, f"{axis}_coord", f"coord{axis}", f"points:{k}", f"points_{k}", f"coordinates:{k}", f"coords:{k}"))
    for k, axis in enumerate("xyz")
)
# The names that are u where there is one of them.
_VALUES: Final = ("u", "value", "values")
# The most columns that a refusal lists.
_MAX_LISTED: Final = 50
HOW: Final = "column=NAME with POST /v1/samples and in Python, --column NAME on the command line"


def header_columns(names: Sequence[str], column: str | None) -> tuple[int, int, int] | None:
    """The numbers, from 0, of the columns x, y and u of a table with a header; None where x or y is not in it.

    Without a ``column`` u is the one of that name, or the only one that is no coordinate. Raises
    :class:`~equimesh.errors.SamplesError`, which lists the columns, where it is not clear.
    """
    plain = [name.casefold() for name in names]
    x, y = (next((k for k, name in enumerate(plain) if name in known), None) for known in _COORDINATES[:2])
    if x is None or y is None:
        return None
    others = [name for k, name in enumerate(names) if k not in (x, y)]
    if len(others) > 1 and column is None:
        heights = [name for name in others if name.casefold() in _COORDINATES[2] and name.casefold() != "z"]
        others = [name for name in others if name not in heights]
    return x, y, names.index(choose(others, column, ("x", "y"), "column"))


def choose(names: Sequence[str], column: str | None, places: Collection[str], what: str) -> str:
    """The name of u among ``names``, those of everything besides ``places``; ``what`` is the noun for one of them.

    Raises :class:`~equimesh.errors.SamplesError` where there is none, or more than one.
    """
    if column is not None:
        found = [name for name in names if name == column] or [
            name for name in names if name.casefold() == column.casefold()
        ]
        if len(found) == 1:
            return found[0]
        raise _unclear(names, f"there is no {what} {column[:80]!r} besides {' and '.join(places)}")
    named = [name for value in _VALUES for name in names if name.casefold() == value]
    if named or len(names) == 1:
        return (named or list(names))[0]
    if not names:
        raise SamplesError(f"there is no {what} besides {' and '.join(places)}: add one with the values of u")
    raise _unclear(names, f"more than one {what} can be u")


def numbered_columns(width: int, column: str | None) -> tuple[int, int, int]:
    """The numbers, from 0, of the columns x, y and u of a table of ``width`` columns without a header.

    Raises :class:`~equimesh.errors.SamplesError` for more than three columns where ``column`` is no number of one.
    """
    if column is not None and column.isdecimal() and len(column) < 9 and 3 <= int(column) <= width:
        return 0, 1, int(column) - 1
    numbers = [str(k) for k in range(3, width + 1)]
    if column is not None:
        raise _unclear(numbers, f"the table has no header, and {column[:80]!r} is no number of a column from 3 on")
    if width <= 3:
        return 0, 1, 2
    raise _unclear(
        [*numbers[:_MAX_LISTED], MATRIX],
        f"the table has {width} columns and no header, so it may be a matrix of values, or x, y and more than one u: "
        f"choose {MATRIX} for a matrix on the uniform grid of the domain, whose first line has the values at the "
        f"smallest x, or the number of the column of u where the first two are x and y",
    )


def _unclear(names: Sequence[str], message: str) -> SamplesError:
    listed = [name[:80] for name in names[: _MAX_LISTED + 1]]
    more = ", ..." if len(names) > len(listed) else ""
    plain = [name if name.isprintable() else repr(name) for name in listed]
    shown = ", ".join(plain) if len(listed) <= 12 else f"{', '.join(plain[:10])}, ..., {plain[-1]}"
    return SamplesError(f"{message}; choose u from {shown}{more}: {HOW}", field="values", columns=tuple(listed))
