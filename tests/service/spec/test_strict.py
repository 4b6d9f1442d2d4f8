"""What is told of a document with many mistakes, and of a word that is nearly known."""

from __future__ import annotations

import re

import httpx
import pytest
from pydantic import TypeAdapter, ValidationError

from equimesh_schema.mesh import MeshSpec
from equimesh_service.problems.problem import Problem
from equimesh_service.spec.strict import MAX_COMPLAINTS, Faults, validate
from service.conftest import small


def test_an_unknown_word_gets_the_nearest_known_one(http: httpx.Client) -> None:
    for spec, pointer, near in (
        ({"monitr": {"u": "x"}}, "/monitr", "monitor"),
        (small(grid={"nxi": 9}), "/grid/nxi", "n_xi"),
        (small(monitor={"kind": "curvatur", "u": "x"}), "/monitor/kind", "curvature"),
        (small(monitor={"u": {"expresion": "x"}}), "/monitor/u", "expression"),
        (small(boundary="Trase"), "/boundary", "trace"),
        (small(monitor={"u": "tnah(x)"}), "/monitor/u", "tanh"),
    ):
        errors = {entry["pointer"]: entry["message"] for entry in http.post("/v1/meshes", json=spec).json()["errors"]}
        assert re.search(f"did you mean '?{near}'?", errors[pointer]), errors


def test_few_faults_are_looked_for() -> None:
    wrong = {"expression": 3, "parameters": {f"p{k}": "a" for k in range(64)}, **{f"q{k}": 1 for k in range(60)}}
    tensor = {"kind": "tensor", "m11": wrong, "m12": wrong, "m22": wrong}
    document = {"monitor": {"kind": "intersection", "monitors": [tensor] * 8}, "grid": 3, "boundary": 1, "cells": 2}
    document |= {f"z{k}": 1 for k in range(100)}
    with pytest.raises(ValidationError) as every:
        TypeAdapter(MeshSpec).validate_python(document)
    assert every.value.error_count() > 1000
    with pytest.raises(ValidationError) as few:
        TypeAdapter(MeshSpec).validate_python(document, context=Faults())
    # Twenty, the fields of the objects that were open then, and one for each object that was not looked at.
    assert few.value.error_count() < 3 * MAX_COMPLAINTS
    with pytest.raises(Problem) as caught:
        validate(MeshSpec, document)
    assert len(caught.value.errors) == MAX_COMPLAINTS
