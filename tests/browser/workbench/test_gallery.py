"""The gallery of the workbench: twelve problems that the service takes, and whose meshes are worth something."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

import pytest

import equimesh as em
from equimesh import specs
from equimesh_service.spec.mesh import read_spec

GALLERY = json.loads(files("equimesh_service").joinpath("workbench", "gallery.json").read_text())["problems"]
NAMES = [problem["name"] for problem in GALLERY]


def test_there_are_twelve_problems_of_different_names() -> None:
    assert len(GALLERY) == len({*NAMES}) == 12
    for problem in GALLERY:
        assert {*problem} - {"time"} == {"name", "title", "sentence", "spec", "sliders"}
        assert problem["sentence"].endswith(".")
        assert len(problem["title"]) < 24


@pytest.mark.parametrize("problem", GALLERY, ids=NAMES)
def test_a_problem_is_a_spec_whose_parameters_are_within_their_sliders(problem: dict[str, Any]) -> None:
    u = read_spec(problem["spec"]).canonical["monitor"]["u"]
    assert {*problem["sliders"]} == {*u["parameters"]}
    for name, ends in problem["sliders"].items():
        assert ends["min"] < u["parameters"][name] < ends["max"]
    if "time" in problem:
        assert problem["time"]["min"] <= u["t"] <= problem["time"]["max"]
    else:
        assert u["t"] == 0


@pytest.mark.parametrize("problem", GALLERY, ids=NAMES)
def test_the_mesh_of_a_problem_has_a_much_smaller_error_than_the_uniform_mesh(problem: dict[str, Any]) -> None:
    half = {name: number // 2 + 1 for name, number in problem["spec"]["grid"].items()}
    mesh = em.solve(specs.build({**problem["spec"], "grid": half}).problem)
    gains = mesh.certificate.interpolation
    assert gains is not None
    assert gains.gain_l2 > 4.5
    assert gains.gain_h1 > 1.7
