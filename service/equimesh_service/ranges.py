"""Byte ranges (RFC 9110, section 14), as far as they must be judged before a file is sent."""

from __future__ import annotations

import re

from starlette.requests import Request

from equimesh_service.problems import Problem

_SPAN = r"\s*(?:\d+-\d*|-\d+)\s*"
_RANGES = re.compile(rf"bytes=({_SPAN}(?:,{_SPAN})*)", re.ASCII | re.IGNORECASE)
_DIGITS = 18  # of a position in a file; more are past its end


def settle_range(request: Request, size: int) -> None:
    """Leave in the request's Range header only what a file of ``size`` bytes has.

    A header that is no range of bytes is ignored; nothing but ranges past the end are a 416 problem.
    """
    header = request.headers.get("range")
    if header is None:
        return
    match = _RANGES.fullmatch(header.strip())
    spans = [span.strip() for span in match[1].split(",")] if match else []
    if not spans or any(_is_backward(span) for span in spans):
        _replace(request, None)
        return
    there = [span for span in spans if _is_inside(span, size)]
    if there:
        _replace(request, "bytes=" + ",".join(there))
    elif "if-range" not in request.headers:
        extent = {"Content-Range": f"bytes */{size}"}
        raise Problem("range-not-satisfiable", f"The file has {size} bytes.", headers=extent)


def _is_backward(span: str) -> bool:
    first, _, last = span.partition("-")
    return bool(first and last) and _number(first) > _number(last)


def _is_inside(span: str, size: int) -> bool:
    first, _, last = span.partition("-")
    return _number(first) < size if first else _number(last) > 0


def _number(digits: str) -> float:
    return int(digits) if len(digits) <= _DIGITS else float("inf")


def _replace(request: Request, header: str | None) -> None:
    others = [pair for pair in request.scope["headers"] if pair[0] != b"range"]
    request.scope["headers"] = others if header is None else [*others, (b"range", header.encode())]
