"""Values on a mesh: where they are, and how they are carried."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.errors import InputError, SamplesError
from equimesh.transfers.mesh_values import mesh_values
from solver.fields.bent_meshes import smooth_mesh


def test_an_array_is_carried_by_splines() -> None:
    field = mesh_values(np.zeros((9, 12)))
    assert (field.transfer, field.location) == ("spline", "nodes")
    assert mesh_values(field) is field


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"transfer": "linear"}, "choose 'spline' or 'conservative'"),
        ({"location": "faces", "transfer": "conservative"}, "choose 'nodes' or 'cells'"),
        ({"location": "cells"}, "averages over cells are carried with their integrals"),
        ({"bounds": (0.0, 1.0)}, "only the conservative transfer keeps bounds"),
        ({"bounds": (1.0, 0.0), "transfer": "conservative"}, "in this order"),
        ({"bounds": 5, "transfer": "conservative"}, "give two numbers"),
        ({"bounds": ("a", "b"), "transfer": "conservative"}, "give two numbers"),
    ],
)
def test_words_that_do_not_fit_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        em.MeshValues(np.zeros((9, 12)), **options)


@pytest.mark.parametrize(
    ("shape", "location", "message"),
    [
        ((8, 11), "nodes", r"needed, shape \(9, 12\), xi first; for values of this shape give location='cells'"),
        ((9, 12), "cells", "give location='nodes'"),
        ((12, 9), "nodes", "transpose it"),
        ((9, 12, 17), "nodes", "17 components"),
    ],
)
def test_values_of_another_shape_are_refused(shape: tuple[int, ...], location: Any, message: str) -> None:
    field = em.MeshValues(np.zeros(shape), transfer="conservative", location=location)
    with pytest.raises(SamplesError, match=message) as caught:
        field.on(smooth_mesh(9), "rho")
    assert caught.value.field == "rho"


def test_lists_of_unequal_lengths_are_refused() -> None:
    with pytest.raises(SamplesError, match="every row must have the same length"):
        em.MeshValues([[1.0, 2.0], [3.0]]).on(smooth_mesh(9), "rho")


def test_values_beyond_their_bounds_or_too_large_are_refused() -> None:
    beyond = em.MeshValues(np.full((9, 12), 2.0), transfer="conservative", bounds=(0.0, 1.0))
    with pytest.raises(SamplesError, match="give bounds that hold"):
        beyond.on(smooth_mesh(9), "rho")
    with pytest.raises(SamplesError, match="rescale"):
        em.MeshValues(np.full((9, 12), 1e300)).on(smooth_mesh(9), "rho")
