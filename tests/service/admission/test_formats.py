"""The formats of whole meshes and of meshes in parts."""

from __future__ import annotations

import pytest

from equimesh_service.admission.formats import check_format, check_head, check_part, check_whole, known_format
from equimesh_service.problems.problem import Problem

WHOLE, PARTED = {"parts": None, "cells": "quad"}, {"parts": "auto", "cells": "quad"}


def test_formats_that_fit() -> None:
    check_format("vtu", WHOLE)
    check_format("pvtu", PARTED)
    check_part("npz")
    assert [known_format(name) for name in ("vtu", "pvtu", "npz")] == ["vtu", "pvtu", "npz"]


def test_formats_that_do_not() -> None:
    with pytest.raises(Problem, match="A pvtu file is the head of a mesh in parts, and this mesh is whole"):
        check_format("pvtu", WHOLE)
    with pytest.raises(Problem, match=r"A mesh in parts is no npz file\. Request one of pvtu, vtkhdf"):
        check_format("npz", PARTED)
    with pytest.raises(Problem, match="A vts file holds no triangles"):
        check_format("vts", {**WHOLE, "cells": "triangle"})
    with pytest.raises(
        Problem,
        match=r"holds cells of order 1\. Request one of vtu, hdf, msh, abaqus, hohqmesh, re2, specfem, or order=1",
    ):
        check_whole("su2", "quad", order=2)
    with pytest.raises(Problem, match=r"in parts hold cells of order 1\. Request order=1"):
        check_head("pvtu", order=2)
    with pytest.raises(Problem, match=r"'vtu' is not a format of parts; .*did you mean 'pvtu'"):
        check_part("vtu")
    with pytest.raises(Problem, match=r"'xyz' is not a mesh format; there are vtu, .*pvtu"):
        known_format("xyz")
    for suffix, name in (("inp", "abaqus"), ("MESH", "medit")):
        with pytest.raises(Problem, match=f"did you mean '{name}'"):
            known_format(suffix)
