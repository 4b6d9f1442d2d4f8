"""A step of a sequence in a worker."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.fields.mesh_map import reference_of
from equimesh.specs import build
from equimesh_service.assembly.bodies import StepField
from equimesh_service.worker.solve import StepStart, certificate_of

GRID = {"n_xi": 13, "n_eta": 9}
BEFORE = em.solve(build({"monitor": {"u": "tanh(20*(x - 0.4))", "kind": "arc_length"}, "grid": GRID}).problem).mesh


def start(fields: dict[str, StepField], **motion: Any) -> StepStart:
    return StepStart(mesh=BEFORE, fields=fields, earlier=None, motion=motion)


@pytest.mark.parametrize("kind", ["arc_length", "curvature"])
@pytest.mark.parametrize("to", [0.42, 0.8])
def test_a_step_of_the_kinds_of_the_release_before_is_the_same_to_the_bit(kind: str, to: float) -> None:
    spec = build({"monitor": {"kind": kind, "u": f"tanh(20*(x - {to}))"}, "grid": GRID})
    expected = spec.solve(start=reference_of(BEFORE, spec.problem.domain), threads=1, check=False)
    field = StepField(values=np.exp(BEFORE.x))
    step = start({"p": field}).take(spec, {"threads": 1, "check": False})
    np.testing.assert_array_equal(step.mesh.x, expected.mesh.x)
    np.testing.assert_array_equal(step.mesh.y, expected.mesh.y)
    np.testing.assert_array_equal(step.fields["p"], em.transfer(BEFORE, {"p": field.values}, expected.mesh)["p"])


def test_a_step_brings_its_fields_its_displacement_and_what_it_says() -> None:
    spec = build({"monitor": {"u": "tanh(20*(x - 0.45))", "kind": "arc_length"}, "grid": GRID})
    fields = {
        "velocity": StepField(values=np.dstack([BEFORE.x, BEFORE.y])),
        "rho": StepField(values=np.ones((12, 8)), transfer="conservative", location="cells", bounds=(0.0, 2.0)),
    }
    before = start(fields, smoothing=0.5)
    step = before.take(spec, {"threads": 1, "check": False})
    data = before.arrived(step.solution.data(), step)
    assert ([*data.fields], [*data.cell_fields]) == (["velocity", "mesh_velocity"], ["rho"])
    np.testing.assert_array_equal(data.fields["mesh_velocity"], step.velocity)
    said = json.loads(data.step)
    assert said["certificate"] == json.loads(json.dumps(certificate_of(step)))
    assert said["fields"]["rho"] == {"transfer": "conservative", "location": "cells", "bounds": [0.0, 2.0]}
    assert (said["status"], said["velocity"], said["substeps"]) == ("succeeded", "mesh_velocity", 1)
    assert said["moved"] == step.moved
    both = StepStart(mesh=BEFORE, fields={**fields, "mesh_velocity": fields["velocity"]}, earlier=None, motion={})
    last = both.take(spec, {"threads": 1, "check": False})
    named = both.arrived(last.solution.data(), last)
    assert json.loads(named.step)["velocity"] is None
    assert sorted(named.fields) == ["mesh_velocity", "velocity"]


def test_what_is_known_of_the_mesh_before(tmp_path: Path) -> None:
    from equimesh_service.worker.solve import _earlier

    class Folder:
        def local(self, name: str) -> Any:
            return (tmp_path / name).open("rb")

    spec = build({"monitor": {"kind": "least_error", "norm": "h1", "u": "x"}, "grid": GRID})
    files: Any = Folder()
    found = _earlier({"u": {"expression": "2*x"}, "samples": None, "gains": {"l2": 3.0, "h1": 2.0}}, spec, files)
    assert found is not None
    assert found.gain == 2.0
    assert found.u is not None
    assert found.u.evaluate(np.array([0.5]), np.array([0.5]))[0] == [1.0]
    lost = _earlier({"u": {"samples": "n-1"}, "samples": "gone", "gains": {"l2": None}}, spec, files)
    assert lost is not None
    assert (lost.u, np.isnan(lost.gain)) == (None, True)
    assert _earlier(None, spec, files) is None
