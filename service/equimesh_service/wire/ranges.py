"""Byte ranges (RFC 9110, section 14) of a file that a request names."""

import re
from dataclasses import dataclass
from itertools import pairwise

from equimesh_service.problems.problem import Problem

_SPAN = r"\s*(?:\d+-\d*|-\d+)\s*"
_RANGES = re.compile(rf"bytes=({_SPAN}(?:,{_SPAN})*)", re.ASCII | re.IGNORECASE)
_MAX_DIGITS = 18  # of a position in a file; more are past its end
# The most ranges of one answer. A request for more, or for ranges that overlap, gets the whole file.
_MAX_RANGES = 16


@dataclass(frozen=True)
class Span:
    """The bytes of a file from ``start`` up to ``end``, without the byte at ``end``."""

    start: int
    end: int

    def content_range(self, size: int) -> str:
        """The value of Content-Range."""
        return f"bytes {self.start}-{self.end - 1}/{size}"


def parse_ranges(header: str | None, size: int) -> tuple[Span, ...]:
    """The parts of a file of ``size`` bytes that a Range header requests; () for the whole file.

    An invalid header is ignored; raises a 416 problem when all ranges are past the end.
    """
    match = _RANGES.fullmatch((header or "").strip())
    if match is None:
        return ()
    written = [span.strip() for span in match[1].split(",")]
    if any(_is_backward(span) for span in written):
        return ()
    there = [found for span in written if (found := _within(span, size))]
    if not there:
        extent = {"Content-Range": f"bytes */{size}"}
        raise Problem("range-not-satisfiable", f"The file has {size} bytes.", headers=extent)
    in_order = sorted(there, key=lambda span: span.start)
    overlap = any(before.end > after.start for before, after in pairwise(in_order))
    return () if overlap or len(there) > _MAX_RANGES else tuple(there)


def _is_backward(span: str) -> bool:
    first, _, last = span.partition("-")
    return bool(first and last) and _number(first) > _number(last)


def _within(span: str, size: int) -> Span | None:
    first, _, last = span.partition("-")
    start = _number(first) if first else max(0, size - _number(last))
    end = min(size, _number(last) + 1) if first and last else size
    return Span(start, end) if start < end else None


def _number(digits: str) -> int:
    return int(digits) if len(digits) <= _MAX_DIGITS else 10**_MAX_DIGITS
