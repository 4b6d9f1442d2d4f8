"""The work of a worker: progress, the entry in the store, steps of sequences, and meshes between iterates."""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import equimesh
import equimesh as em
from equimesh.fields.on_domain import reference_of
from equimesh.specs import build
from equimesh_cluster.solving import Progress
from equimesh_service.assembly.bodies import StepField
from equimesh_service.errors import AttemptLostError, KeyTakenError
from equimesh_service.store.rows import Artifact, Claim, Lease, NewEntry, NewMesh, Outcome
from equimesh_service.store.store import Store
from equimesh_service.worker import drawing as module
from equimesh_service.worker.drawing import Frames
from equimesh_service.worker.reporter import Reporter
from equimesh_service.worker.solve import Attempt, StepStart, certificate_of
from service.store.stores import SPEC, add, claimed, status


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(f"sqlite:///{tmp_path / 'a.sqlite3'}")
    store.prepare()
    return store


def new(store: Store, mesh_id: str = "a", key: str | None = None) -> Attempt:
    entry = NewEntry(new=NewMesh(id=mesh_id, spec=SPEC), key=key, fingerprint="f")
    return Attempt(store, Claim(mesh_id, 1), entry, Lease(owner="me", seconds=10.0))


def test_a_new_mesh_enters_with_its_first_progress(store: Store) -> None:
    attempt = new(store)
    assert store.meshes.get("a") is None
    assert attempt.report({"stage": "start"})
    assert (status(store, "a"), attempt.entry) == ("running", None)
    assert attempt.report({"stage": "writing"})
    assert attempt.keep(Outcome(result={}), 1.0)
    assert status(store, "a") == "succeeded"
    assert [event.kind for event in store.meshes.events("a")] == ["status", "status", "progress", "progress", "done"]


def test_a_mesh_that_has_just_begun_is_not_entered(store: Store) -> None:
    attempt = new(store)
    attempt.began = time.perf_counter() + 3600.0
    attempt.enter_if_late()
    assert attempt.report({})
    assert store.meshes.get("a") is None
    attempt.began = float("-inf")
    attempt.enter_if_late()
    assert status(store, "a") == "running"


def test_without_progress_it_enters_finished(store: Store) -> None:
    assert new(store).keep(Outcome(result={}, files=[Artifact("mesh", "0" * 64, 1)]), 1.0)
    assert [event.kind for event in store.meshes.events("a")] == ["status", "status", "done"]


def test_an_entered_mesh_that_is_canceled_or_deleted_is_lost(store: Store) -> None:
    attempt = new(store)
    attempt.report({})
    assert store.queue.cancel("a")
    assert not attempt.report({})
    store.meshes.delete("a", lambda _: None)
    assert not attempt.report({})  # and it does not come back
    assert not attempt.keep(Outcome(result={}), 1.0)
    assert store.meshes.get("a") is None


@pytest.mark.parametrize("finished", [False, True])
def test_a_key_that_another_mesh_has_ends_the_attempt(store: Store, finished: bool) -> None:
    new(store, "first", key="x").report({})
    attempt = new(store, "second", key="x")
    with pytest.raises(KeyTakenError) as caught:
        _ = attempt.keep(Outcome(result={}), 1.0) if finished else attempt.report({})
    assert caught.value.mesh_id == "first"
    assert store.meshes.get("second") is None


def test_a_mesh_of_the_queue_is_there_from_the_beginning(store: Store) -> None:
    add(store, "a")
    attempt = Attempt(store, claimed(store))
    assert attempt.report({})
    assert attempt.keep(Outcome(result={}), 1.0)
    assert not attempt.report({})


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
        def opened(self, name: str) -> Any:
            return (tmp_path / name).open("rb")

        def require(self, name: str) -> None:
            self.opened(name).close()

    spec = build({"monitor": {"kind": "least_error", "norm": "h1", "u": "x"}, "grid": GRID})
    files: Any = Folder()
    found = _earlier({"u": {"expression": "2*x"}, "samples": None, "gains": {"l2": 3.0, "h1": 2.0}}, spec, files)
    assert found.gain == 2.0
    assert found.u.evaluate(np.array([0.5]), np.array([0.5]))[0] == [1.0]
    lost = _earlier({"u": {"samples": "n-1"}, "samples": "gone", "gains": {"l2": None}}, spec, files)
    assert (lost.u, np.isnan(lost.gain)) == (None, True)
    assert _earlier(None, spec, files) is None


U = equimesh.Expression("(1-exp(15*(x-1)))*sin(pi*y)")
PROBLEM = equimesh.Problem(monitor=equimesh.ArcLength(u=U), grid=equimesh.Grid(n_xi=12, n_eta=12))


def told_by(schwarz: equimesh.Schwarz | None, interval: float) -> list[Mapping[str, Any]]:
    told: list[Mapping[str, Any]] = []

    def tell(row: Mapping[str, Any]) -> bool:
        told.append(row)
        return True

    reporter = Reporter(schwarz, tell, interval=interval)
    equimesh.solve(PROBLEM, schwarz, observe=reporter, check=False)
    reporter.writing()
    reporter.measuring()
    return told


@pytest.mark.parametrize(
    "schwarz",
    [
        None,
        equimesh.Schwarz(overlap=2),
        equimesh.Schwarz(overlap=2, tolerance="discretization"),
        equimesh.Schwarz(overlap=2, tolerance=None, max_iterations=3),
    ],
)
def test_the_fraction_grows_to_nearly_one(schwarz: equimesh.Schwarz | None) -> None:
    told = told_by(schwarz, interval=0.0)
    fractions = [row["fraction"] for row in told if row["fraction"] is not None]
    assert fractions == sorted(fractions)
    assert 0.0 <= fractions[0] < fractions[-1] == 0.9
    assert [row["phase"] for row in told[-2:]] == ["writing the files", "measuring the quality"]
    stages = list(dict.fromkeys(row["stage"] for row in told))
    assert stages == (
        ["single_domain", "writing", "measuring"] if schwarz is None else ["start", "schwarz", "writing", "measuring"]
    )


def test_sweeps_of_parts_tell_their_level_and_the_number_of_parts() -> None:
    told: list[Mapping[str, Any]] = []
    reporter = Reporter(None, lambda row: told.append(row) is None, interval=0.0)
    for level, step in itertools.product((2, 3), (1, 2, 9)):
        grid = equimesh.Grid(n_xi=2**level + 1, n_eta=9)
        share, phase = (level + step / 10) / 4, f"sweeping the {grid} grid in 3 parts"
        reporter.part(
            Progress(level=level, levels=4, grid=grid, step=step, residual=0.5, parts=3, fraction=share, phase=phase)
        )
    reporter.writing()
    assert {(row["stage"], row["parts"]) for row in told[:-1]} == {("parts", 3)}
    assert (told[0]["level"], told[0]["levels"], told[0]["grid"], told[0]["iteration"]) == (2, 4, [5, 9], 1)
    assert told[0]["phase"] == "sweeping the 5 x 9 grid in 3 parts"
    assert [row["fraction"] for row in told] == [0.42, 0.44, 0.58, 0.62, 0.64, 0.78, 0.8]


def test_a_descent_tells_its_grid_its_error_and_its_gain() -> None:
    told: list[Mapping[str, Any]] = []
    reporter = Reporter(None, lambda row: told.append(row) is None, interval=0.0)
    problem = equimesh.Problem(monitor=equimesh.LeastError(u=U), grid=equimesh.Grid(n_xi=17, n_eta=17))
    solution = equimesh.solve(problem, observe=reporter, threads=1)
    reporter.writing()
    assert len(told) == len(solution.descent) + 1
    assert {row["stage"] for row in told[:-1]} == {"least_error"}
    fractions = [row["fraction"] for row in told]
    assert fractions == sorted(fractions)
    assert 0.0 <= fractions[0] < fractions[-1] == 0.8
    for row, record in zip(told, solution.descent, strict=False):
        assert row["residual"] is None
        assert row["phase"].startswith("descending, step ") or row["phase"] == "writing the files"
        assert (row["iteration"], row["grid"], row["level"]) == (record["step"], record["grid"], record["level"])
        assert (row["error"], row["gain"]) == (record["error"], record["gain"])


def test_a_report_without_a_share_has_no_fraction_and_later_ones_do_not_fall() -> None:
    told: list[Mapping[str, Any]] = []
    reporter = Reporter(None, lambda row: told.append(row) is None, interval=0.0)
    step = equimesh.Step(
        level=0, levels=1, grid=PROBLEM.grid, step=1, residual=0.5, mesh=equimesh.Mesh.uniform(PROBLEM.grid)
    )
    for fraction, phase in ((0.5, "sweeping"), (None, "relaxing, step 1"), (0.25, "sweeping")):
        reporter(replace(step, fraction=fraction, phase=phase))
    assert [row["fraction"] for row in told] == [0.4, None, 0.4]
    assert told[1]["phase"] == "relaxing, step 1"


def test_nothing_is_told_of_a_solve_that_is_over_in_no_time() -> None:
    assert told_by(equimesh.Schwarz(overlap=2), interval=3600.0) == []


def test_little_is_told_in_little_time(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = itertools.count()
    # A second goes by between two looks. The clock of the reporter alone: event loops of other tests read the real one.
    monkeypatch.setattr("equimesh_service.worker.reporter.monotonic", lambda: float(next(ticks)))
    schwarz = equimesh.Schwarz(overlap=2, tolerance=None, max_iterations=20)
    every, some = told_by(schwarz, interval=1.0), told_by(schwarz, interval=4.0)
    assert 2 < len(some) <= len(every) * 0.6
    assert some[-1]["stage"] == "measuring"


def test_a_lost_attempt_ends_the_solve() -> None:
    reporter = Reporter(None, lambda _: False, interval=0.0)
    with pytest.raises(AttemptLostError):
        equimesh.solve(PROBLEM, observe=reporter)


def records(count: int) -> list[Any]:
    """The real records of so many iterations, and the start."""
    found: list[Any] = []
    problem = em.Problem(monitor=em.ArcLength(u=em.Expression("tanh(9*x)")), grid=em.Grid(n_xi=8, n_eta=7))
    settings = em.Schwarz(transmission=em.Classical(), overlap=2, tolerance=None, max_iterations=count)
    em.solve(problem, settings, observe=found.append)
    return [event for event in found if isinstance(event, em.Iteration)]


def test_all_meshes_of_a_short_iteration_are_kept() -> None:
    events, frames = records(5), Frames(56)
    for event in [SimpleNamespace(iteration=0), *events]:  # events of the start have no mesh of the iteration
        frames(event)
    arrays = frames.arrays()
    assert frames.numbers == [*range(6)]
    for number, event in enumerate(events):
        assert np.array_equal(arrays["frames_x"][number], event.mesh.x.astype(np.float32))
        assert np.array_equal(arrays["frames_y"][number], event.mesh.y.astype(np.float32))


@pytest.mark.parametrize(("most", "kept"), [(12, [*range(12)]), (11, [0, 2, 4, 6, 8, 10, 11]), (4, [0, 4, 8, 11])])
def test_a_long_iteration_is_thinned_evenly_and_has_its_end(
    monkeypatch: pytest.MonkeyPatch, most: int, kept: list[int]
) -> None:
    monkeypatch.setattr(module, "MAX_COORDINATES", most * 56)
    monkeypatch.setattr(module, "MIN_FRAMES", 2)
    events, frames = records(11), Frames(56)
    for event in events:
        frames(event)
    arrays = frames.arrays()
    assert frames.numbers == kept
    assert arrays["frames_y"].shape == (len(kept), 8, 7)
    assert np.array_equal(arrays["frames_x"][-1], events[-1].mesh.x.astype(np.float32))


def test_only_the_last_of_two_iterations_is_kept() -> None:
    frames = Frames(56)
    for event in [*records(5), *records(3)]:
        frames(event)
    assert len(frames.arrays()["frames_x"]) == 4
    assert frames.numbers == [*range(4)]


def test_without_an_iteration_there_are_no_frames() -> None:
    assert Frames(56).arrays() == {}
