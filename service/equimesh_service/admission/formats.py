"""The formats in which a mesh may be requested: those of whole meshes, and those of meshes in parts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from equimesh.io.formats import FORMATS
from equimesh_schema.domains import DOMAINS
from equimesh_schema.mesh import SUFFIXES
from equimesh_service.problems.problem import Problem, did_you_mean
from equimesh_service.worker.part_formats import HEADED, PART_FORMATS


def known_format(name: str) -> str:
    """The name of a format of meshes, whole or in parts, checked; raises a 406 problem."""
    known = [*FORMATS, *(head for head in HEADED if head not in FORMATS)]
    if name not in known:
        named = SUFFIXES.get(f".{name.lower()}")  # people know the suffix of their file: inp is abaqus
        near = did_you_mean(named or name, known) or "."
        raise Problem("not-acceptable", f"{name[:40]!r} is not a mesh format; there are {', '.join(known)}{near}")
    return name


def check_format(format: str, spec: Mapping[str, Any]) -> None:
    """Raise a 406 problem for a format in which the mesh of a canonical spec is no file."""
    if spec["parts"] is None:
        made = DOMAINS.documents[spec.get("domain", {}).get("kind", DOMAINS.default)]
        check_whole(format, spec["cells"], is_grid=not made.HAS_BLOCKS)
    else:
        check_head(format)


def check_whole(format: str, cells: str, *, is_grid: bool = True, order: int = 1) -> None:
    """Raise a 406 problem for a format that no whole mesh has, or that does not hold these cells, or no blocks."""
    if format not in FORMATS:
        detail = f"A {format} file is the head of a mesh in parts, and this mesh is whole."
        raise Problem("not-acceptable", f"{detail} Request one of {', '.join(FORMATS)}.")
    if not is_grid and FORMATS[format].grids_only:
        known = ", ".join(name for name, form in FORMATS.items() if not form.grids_only)
        raise Problem("not-acceptable", f"A {format} file is a grid, and this mesh has blocks. Request one of {known}.")
    if cells not in FORMATS[format].cells:
        raise Problem("not-acceptable", f"A {format} file holds no {cells}s. Request cells=quad or another format.")
    if order == 2 and not FORMATS[format].second_order:
        known = ", ".join(name for name, form in FORMATS.items() if form.second_order)
        detail = f"A {format} file holds cells of order 1. Request one of {known}, or order=1."
        raise Problem("not-acceptable", detail)


def check_head(format: str, cells: str = "quad", order: int = 1) -> None:
    """Raise a 406 problem for a format in which a mesh in parts has no head."""
    if format not in HEADED:
        raise Problem("not-acceptable", f"A mesh in parts is no {format} file. Request one of {', '.join(HEADED)}.")
    if cells != "quad":
        raise Problem("not-acceptable", "The files of a mesh in parts hold quadrilaterals. Request cells=quad.")
    if order != 1:
        raise Problem("not-acceptable", "The files of a mesh in parts hold cells of order 1. Request order=1.")


def check_part(format: str) -> None:
    """Raise a 406 problem for a format in which there are no parts."""
    if format not in PART_FORMATS:
        near = did_you_mean(format, PART_FORMATS) or "."
        detail = f"{format[:40]!r} is not a format of parts; there are {', '.join(PART_FORMATS)}{near}"
        raise Problem("not-acceptable", detail)
