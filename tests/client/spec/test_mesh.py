"""Options of a mesh, and the spec that is made of them."""

from __future__ import annotations

from typing import Any, get_type_hints

import numpy as np
import pytest

from equimesh_client import BadArgument, Target
from equimesh_client.spec.request import DEFAULTS, MeshOptions, mesh_spec, points_per_side


def test_a_spec_with_all_defaults() -> None:
    assert mesh_spec({"kind": "weight"}, 64) == {
        "monitor": {"kind": "weight"},
        "grid": {"n_xi": 64, "n_eta": 64},
        "boundary": "trace",
        "initial": "nested",
        "schwarz": None,
        "cells": "quad",
    }


def test_a_spec_with_other_options() -> None:
    spec = mesh_spec({}, 8, {"domain": {"kind": "rectangle"}, "mode": "tight", "allow_relaxed": False, "label": "mine"})
    assert [spec[name] for name in ("domain", "mode", "allow_relaxed", "label")] == [
        {"kind": "rectangle"},
        "tight",
        False,
        "mine",
    ]


def test_every_option_has_a_type_and_a_default() -> None:
    assert get_type_hints(MeshOptions).keys() == DEFAULTS.keys()


def test_an_unknown_option_names_the_nearest(connect: Any, service: Any) -> None:
    client = connect(service.url)
    for method, option, words in (
        (client.generate, "bounday", r"generate\(\) has no option 'bounday'; did you mean 'boundary'\?"),
        (client.generate, "deadlin", "did you mean 'deadline'"),
        (client.generate, "xyz", "it has monitor, domain, a, b, "),
        (client.sequences.start, "kep", "did you mean 'keep'"),
        (client.sequences.start, "initial", "has no option 'initial'"),
    ):
        with pytest.raises(TypeError, match=words):
            method("x", 8, **{option: 1})
    assert service.requests == []


@pytest.mark.parametrize("n", [0.5, "a", None, (1, 2, 3), (4, 4.5), "12"])
def test_n_is_a_number_or_a_pair(n: Any) -> None:
    with pytest.raises(BadArgument, match=r"schwarz is a Schwarz, such as .*; not 4"):
        mesh_spec({"kind": "arc_length"}, 9, {"schwarz": 4})  # type: ignore[typeddict-item]
    with pytest.raises(BadArgument, match="n is the number of points"):
        points_per_side(n)


def test_n_may_come_from_numpy() -> None:
    assert points_per_side(np.int64(5)) == (5, 5)
    assert points_per_side((np.int32(5), 6)) == (5, 6)


def test_a_target_takes_the_place_of_the_grid() -> None:
    spec = mesh_spec({}, 64, {"target": Target(error=1e-4, norm="h1")})
    assert "grid" not in spec
    assert spec["target"] == {"norm": "h1", "error": 1e-4, "max_points": None}
    assert mesh_spec({}, 64, {"target": {"error": 1}})["target"] == {"error": 1}
    with pytest.raises(BadArgument, match="takes the place of n"):
        mesh_spec({}, 65, {"target": Target(error=1e-4)})
