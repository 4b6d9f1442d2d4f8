"""The benchmarks run and count right. Times are for reading: nothing here looks at a clock."""

from __future__ import annotations

import json
import math
import os
import runpy
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import adapt
import bench
import cluster
import cold_start
import convection
import goals
import golden
import latency
import least_error_gains
import least_error_goals
import numpy as np
import parted_files
import pytest
import refinement
import road
from biquadratic_elements import BiquadraticElements
from costs import budget, newton, peers, solves
from costs.budget import Bought, Curve
from costs.quadrature import errors
from costs.rows import Row, lines
from distributed import Client, LocalCluster
from random_functions import KINDS, RandomFunction, random_functions

import equimesh as em
import geometry
from equimesh.testing import geometries
from equimesh_cluster import PARTED_FORMATS
from equimesh_coupling.goals import goal_values

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"
TINY = bench.Sizes(large=65, small=(17,), newton=33, huge=None, kernels=False)


@pytest.fixture(scope="module")
def tiny() -> dict[str, Row]:
    return {row.what: row for row in bench._rows(TINY)}


def test_the_table_has_a_row_for_everything(tiny: dict[str, Row]) -> None:
    expected = [
        *("n = 65, discretization", "n = 65, tight", "n = 65, algebraic over discretisation error"),
        *("n = 65, discretization, two threads against one", "n = 65, tight, two threads against one"),
        *("n = 65, discretization, CPU time of the busier one", "n = 65, tight, CPU time of the busier one"),
        *("n = 17, expression, the whole call", "n = 17, 65 x 65 samples, the whole call"),
        *("n = 33, sweeps on the finest level", "n = 33, Newton with SuperLU"),
    ]
    assert set(expected) <= set(tiny)
    assert all(math.isfinite(row.value) and row.value > 0.0 for row in tiny.values())
    assert all(json.loads(json.dumps(row.plain())) == row.plain() for row in tiny.values())


def test_what_is_not_shared_is_counted(tiny: dict[str, Row]) -> None:
    """The measured share is not asserted: threads of other programs of a busy machine count in it."""
    assert solves.not_shared(busier=1.0, both=1.0) == 1.0
    assert solves.not_shared(busier=0.75, both=1.0) == 0.5
    assert solves.not_shared(busier=0.5, both=1.0) == solves.not_shared(busier=0.4, both=1.0) == 0.0
    alone = float(tiny["n = 65, tight, CPU time of the busier one"].note.partition(" ")[0]) / 100.0
    assert alone >= 0.0  # times of several runs: above 1 where other programs interrupted one of them


def test_finer_grids_take_no_more_sweeps(tiny: dict[str, Row]) -> None:
    counts = tiny["n = 65, discretization"].counts
    assert list(counts) == ["17", "33", "65"]
    assert max(counts["33"], counts["65"]) <= 3
    tight = tiny["n = 65, tight"].counts
    assert counts["65"] < tight["65"] <= 14
    assert {n: tight[n] for n in ("17", "33")} == {n: counts[n] for n in ("17", "33")}


def test_what_stops_the_sweeps_is_true(tiny: dict[str, Row]) -> None:
    row = tiny["n = 65, algebraic over discretisation error"]
    assert row.goal == 0.2
    assert row.met is True


def test_newton_goes_to_the_mesh_of_the_sweeps(tiny: dict[str, Row]) -> None:
    assert tiny["n = 33, sweeps on the finest level"].counts["sweeps"] <= 14
    rows = {what: row for what, row in tiny.items() if "Newton" in what}
    assert len(rows) == (4 if newton.has_pardiso() else 2)
    for what, row in rows.items():
        assert 2 <= row.counts["steps"] <= (10 if "kept" in what else 5), what
        assert float(row.note.rpartition(" ")[2]) < 1e-9, what


def test_a_goal_is_met_from_the_right_side() -> None:
    assert Row(what="", value=1.0, unit="s", goal=2.0).met is True
    assert Row(what="", value=3.0, unit="s", goal=2.0).met is False
    assert Row(what="", value=1.0, unit="x", goal=2.0, at_least=True).met is False
    assert Row(what="", value=1.0, unit="x").met is None
    heading, line = lines([Row(what="", value=3.0, unit="s", goal=2.0)])
    assert line.endswith("<= 2     not met")
    assert heading.endswith("goal (of the developers, on an idle machine)")


def test_goals_are_for_the_sizes_that_they_were_set_for(tiny: dict[str, Row]) -> None:
    assert [row.what for row in tiny.values() if row.goal is not None] == [
        "n = 65, algebraic over discretisation error"
    ]


def test_our_meshes_are_measured_beside_the_uniform_one() -> None:
    found = {mesh.mesher: mesh for mesh in peers.ours("ring", em.Expression(peers.FUNCTIONS["ring"]), 33)}
    assert list(found) == ["uniform", "equimesh LeastError", "equimesh ArcLength", "equimesh Curvature"]
    assert {mesh.vertices for mesh in found.values()} == {33 * 33}
    assert found["equimesh LeastError"].l2 < found["equimesh Curvature"].l2 < found["uniform"].l2
    ring = em.Curvature(u=em.Expression(peers.FUNCTIONS["ring"]))
    errors = em.solve(em.Problem(monitor=ring, grid=em.Grid(n_xi=33, n_eta=33)))
    assert found["equimesh Curvature"].l2 == pytest.approx(errors.interpolation.l2, rel=0.02)


@pytest.mark.parametrize("kind", ["quads", "triangles"])
def test_the_quadrature_of_gradients_is_exact_where_the_error_is_known(kind: str) -> None:
    n = 5
    mesh = em.Mesh.uniform(em.Grid(n_xi=n, n_eta=n))
    points, cells = (mesh.points, mesh.cells) if kind == "quads" else peers._uniform_triangles(n)
    bent = points + 0.05 * np.sin(7 * points[:, ::-1])  # linear functions are exact on any mesh
    h = 1.0 / (n - 1)
    l2, h1 = errors(points, cells, lambda x, y: (x**2 + y, 2 * x, np.ones_like(y)))
    assert l2 == pytest.approx(h**2 / math.sqrt(30.0), rel=1e-12)
    assert h1 == pytest.approx(h / math.sqrt(3.0), rel=1e-12)  # the error of the slope is 2 x - h, from -h to h
    assert max(errors(bent, cells, lambda x, y: (2 * x - 3 * y, np.full_like(x, 2.0), np.full_like(y, -3.0)))) < 1e-13


def test_a_budget_buys_the_best_mesh_that_took_no_longer() -> None:
    meshes = (Bought(0.04, 1e-4), Bought(0.01, 1e-2), Bought(0.02, 2e-2), Bought(1.0, 1e-5))
    curve = Curve(function="u", mesher="one", meshes=meshes)
    assert curve.at(0.005) is None
    assert curve.at(0.04) == pytest.approx(1e-4)
    assert curve.at(0.02) == pytest.approx(1e-3)  # between 0.01 and 0.04, not the mesh that is worse
    assert curve.at(0.2) == pytest.approx(1e-4 * 0.1**0.5)
    assert curve.at(5.0) == 1e-5


def test_the_least_error_of_a_budget_is_starred() -> None:
    found = [
        Curve(function="u", mesher="slow", meshes=(Bought(0.5, 1e-5), Bought(2.0, 1e-6))),
        Curve(function="u", mesher="quick", meshes=(Bought(0.01, 1e-3), Bought(2.0, 1e-4))),
    ]
    _, slow, quick = budget.lines(found, (0.1, 2.0))
    assert slow.split() == ["u", "slow", "-", "1.00e-06*"]
    assert quick.split()[2].endswith("*")
    assert quick.split()[3] == "1.00e-04"


def test_curves_of_all_meshers_stop_after_the_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(budget, "SIZES", (9, 13, 17))
    u = em.Expression(peers.FUNCTIONS["ring"])
    curves = list(budget.curves("ring", u, {"ours": em.ArcLength(u=u)}))
    sizes = {curve.mesher: len(curve.meshes) for curve in curves}
    assert sizes["ours"] == 3
    assert sizes.get("Mmg2d", 3 * peers.PASSES) == 3 * peers.PASSES
    assert sizes.get("Gmsh", 3) == 3
    assert all(mesh.cpu > 0.0 for curve in curves for mesh in curve.meshes)
    spent = list(budget.curves("ring", u, {"ours": em.ArcLength(u=u)}, budget=0.0))
    assert len(spent[0].meshes) == 1


def test_gains_are_those_of_the_solution() -> None:
    u = em.Expression(least_error_goals.CURVED["paper"].u)
    solution = least_error_gains.solve(em.LeastError(u=u), 33)
    found, own = least_error_gains.measure(u, solution.mesh), solution.interpolation
    assert found.l2 == pytest.approx(own.gain_l2, rel=0.05)
    assert found.h1 == pytest.approx(own.gain_h1, rel=0.05)
    assert least_error_gains.measure(u, em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))) == (1.0, 1.0)


def test_what_goes_wrong_with_random_functions_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    solutions = iter(["raise", "folded", "worse", "uniform"] * 3)

    class Solved:
        def __init__(self, mesh: em.Mesh) -> None:
            self.mesh = mesh

    def fake(_: em.Monitor, n: int) -> Solved:
        kind, mesh = next(solutions), em.Mesh.uniform(em.Grid(n_xi=n, n_eta=n))
        if kind == "raise":
            raise ZeroDivisionError
        if kind == "folded":
            return Solved(em.Mesh(1.0 - mesh.x, mesh.y))
        return Solved(em.Mesh(mesh.x**3, mesh.y**3) if kind == "worse" else mesh)

    monkeypatch.setattr(least_error_gains, "solve", fake)
    same = [RandomFunction("peak", "exp(9*(1 - x)*y)")] * 4
    monkeypatch.setattr(least_error_gains, "random_functions", lambda *_: same)
    rows = {row.what.partition("l2: ")[2]: row for row in least_error_gains.unseen(1, 4, 9) if "norm l2" in row.what}
    assert {what: row.value for what, row in rows.items() if row.goal == 0} == {
        "gain below 1 in L2": 1,
        "folded": 1,
        "exceptions": 1,
    }
    assert rows["exceptions"].note == "ZeroDivisionError: 1"
    assert rows["folded"].met is False


@pytest.mark.parametrize("library", ["mmgpy", "gmsh"])
def test_peers_make_as_many_vertices(library: str) -> None:
    if not peers.is_installed(library):
        pytest.skip(f"{library} is not installed")
    work = peers.mmg if library == "mmgpy" else peers.gmsh
    found = work("ring", em.Expression(peers.FUNCTIONS["ring"]), 33)
    assert abs(found.vertices / 33**2 - 1.0) <= peers.MAX_VERTEX_DEVIATION_SHARE


def test_random_functions_are_those_of_their_seed() -> None:
    functions = random_functions(1, 120)
    assert functions[:5] == random_functions(1, 5)
    assert functions[:5] != random_functions(2, 5)
    assert {function.kind for function in functions} == {*KINDS, "sum"}


def test_every_random_function_varies_on_the_square() -> None:
    at = np.linspace(0.0, 1.0, 33)
    for kind, u in random_functions(3, 60):
        (values,) = em.Expression(u).evaluate(*np.meshgrid(at, at, indexing="ij"))
        assert 0.1 < np.ptp(values) < 10.0, (kind, u)


@pytest.mark.parametrize(
    ("script", "arguments", "said"),
    [
        ("least_error.py", ["--points", "17", "--functions", "paper", "--parts", "gains"], "paper, smoothness"),
        ("newton.py", ["--points", "33"], "Newton with SuperLU"),
        ("random_functions.py", ["--count", "3"], "tanh("),
        ("unseen.py", ["--count", "3", "--points", "17"], "| 17 x 17 |"),
        ("peers.py", ["--points", "17", "--functions", "paper"], "equimesh ArcLength"),
    ],
)
def test_the_scripts_run(
    script: str, arguments: list[str], said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [script, *arguments])
    runpy.run_path(str(BENCHMARKS / script), run_name="__main__")
    assert said in capsys.readouterr().out


def test_the_loop_that_adapts_has_a_row_for_a_problem() -> None:
    *_, row = adapt.loop_rows(["E"], 17, 1)
    name, gains, efficiency, resolved = (cell.strip() for cell in row.strip("|").split("|"))
    assert (name, resolved) == ("E", "yes")
    l2, h1 = map(float, gains.split(" / "))
    assert l2 > 1.2
    assert h1 > 1.1
    assert 0.5 < float(efficiency) < 2.0


def test_the_supg_parameter_is_bounded_on_thin_cells_alone() -> None:
    square = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    thin = em.Mesh(square.x, 0.01 * square.y)
    for mesh, is_bounded in ((square, False), (thin, True)):
        usual, bounded = (
            convection.supg_parameter(mesh.to_skfem(), (1.0, 0.0), 1e-3, kind) for kind in ("usual", "thin")
        )
        assert usual == pytest.approx(0.0625 * (1 / math.tanh(62.5) - 1 / 62.5))
        assert bounded == pytest.approx(0.00125**2 / 0.012 if is_bounded else usual)


@pytest.mark.parametrize("name", ["A", "C", "D", "E"])
def test_the_elements_of_the_loop_converge_at_second_order_for_each_stream(name: str) -> None:
    problem, errors = adapt.ALL[name], []
    for n in (9, 17):
        mesh = em.Mesh.uniform(em.Grid(n_xi=n, n_eta=n))
        smooth = convection.Problem(u="sin(2*x)*exp(y)", eps=0.5, b=problem.b, c=problem.c)
        errors.append(smooth.errors(mesh, smooth.solve(mesh))[0])
    assert 3.5 < errors[0] / errors[1] < 4.5


def test_files_of_parts_are_measured_in_every_format(tmp_path: Path) -> None:
    found = parted_files.costs(65, 3, tmp_path)
    assert [cost.format for cost in found] == [*PARTED_FORMATS]
    sizes = {cost.format: cost.bytes for cost in found}
    assert 28 < sizes["zarr"] + 20 < sizes["pvtu"] < sizes["vtkhdf"]  # u, x, y, and the number of the part
    assert all(math.isfinite(cost.write + cost.head + cost.read) for cost in found)
    assert [*tmp_path.iterdir()] == []
    assert len(parted_files.lines(found)) == 2 + len(found)


def test_the_model_of_many_machines_counts_levels_and_messages() -> None:
    machines = cluster.Machines()
    one, more = (cluster.model(65537, parts, machines) for parts in (1, 64))
    assert one["messages"] == 0.0
    assert more["messages"] > 0.0
    assert more["GB a part"] == 65 * 65537**2 / 64 / 1e9
    assert one["work"] == pytest.approx(64 * more["work"])
    assert more["work"] == pytest.approx(45e-9 * 65537**2 * 4 / 3 / 64, rel=1e-3)
    assert more["coarse points"] == 1025
    assert cluster.model(262145, 1000, machines)["coarse points"] == 8193  # a strip of 16 rows for each part, above it
    assert more["seconds"] == pytest.approx(more["coarse"] + more["work"] + more["messages"] + more["start"])
    assert more["efficiency"] == pytest.approx(more["work"] / more["seconds"])


def test_a_mesh_by_parts_is_written_and_read_back(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """In threads of this process; the benchmark itself takes processes."""

    @contextmanager
    def threads(workers: int) -> Iterator[Client]:
        options = {"threads_per_worker": 1, "memory_limit": 0, "dashboard_address": ":0", "processes": False}
        with LocalCluster(n_workers=workers, **options) as machines, Client(machines) as client:
            yield client

    monkeypatch.setattr(cluster, "cluster", threads)
    monkeypatch.setattr(cluster, "warm_up", lambda *_: None)
    lines = list(cluster.large(65, 1, "pvtu", str(tmp_path)))
    assert lines[0].startswith("65 x 65 = 0 million points in 1 parts: The mesh satisfies")
    assert "sent: 0.0 MB in 0 messages" in lines[3]
    assert lines[-1].endswith("equal to the last bit")
    assert list(tmp_path.iterdir()) == []


def test_geometries_are_measured_with_fronts_on_their_window() -> None:
    domain = geometries.l_shape(300)
    fronts = list(geometry.functions(domain, "l_shape", 3, 2))
    assert len({u.text for u in fronts}) == 2
    found = geometry.solve(domain, fronts[0])
    assert found.gain > 1.0
    assert not found.folded
    assert 0.5 < found.within <= 1.0
    assert geometry.mean([2.0, 8.0]) == pytest.approx(4.0)


def test_chosen_counts_are_compared_with_those_of_the_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(geometry, "BUDGETS", {"layer": geometry.BUDGETS["layer"]})
    monkeypatch.setattr(em, "adapt", partial(em.adapt, rounds=2))
    l2 = next(geometry.budget(200))
    assert l2.value > 2.0
    assert "chosen" in l2.note


def test_the_roads_are_counted() -> None:
    """The files that calls visit come in the order of their paths, and exist."""
    counted = {count.name: count for count in road.roads(posted=False)}
    assert {*counted} == {"auto", "arc_length"}
    for count in counted.values():
        assert count.value == len(count.files) > 5
        assert all((road.ROOT / file).is_file() for file in count.files)
    assert "solver/equimesh/solving/solve.py" in counted["auto"].files
    assert {count.name: count.value > 0 for count in road.sizes()} == dict.fromkeys(
        ("lines", "files", "tests", "words"), True
    )


def test_golden_meshes_are_made_and_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = list(golden.problems())
    assert len(made) >= 300
    kinds = {problem.kind: problem for problem in made}
    assert set(kinds) == {"grids", "metrics", "domains", "schwarz", "samples", "blocks", "rounds", "sequences"}
    nodes = kinds["domains"].nodes()
    np.savez(tmp_path / "before.npz", **{"domains 0": nodes, "domains 1": nodes})
    np.savez(tmp_path / "moved.npz", **{"domains 0": nodes, "domains 1": nodes + 1e-6})
    np.savez(tmp_path / "lost.npz", **{"domains 0": nodes})

    def same(after: str, *options: str) -> bool:
        return golden.main(["compare", str(tmp_path / "before.npz"), str(tmp_path / after), *options]) == 0

    assert same("before.npz")
    assert not same("moved.npz")
    assert "domains 1: moved by" in capsys.readouterr().out
    assert same("moved.npz", "--within", "1e-5")
    assert not same("lost.npz")


def test_latency_counts_all_processes_of_a_server() -> None:
    with latency.echo() as (url, pid):
        cost = latency.one_caller("echo", url, pid, latency.PATHS["kept"], 9, 3)
        assert (cost.what, cost.points) == ("echo", 9)
        assert latency.cpu_seconds(pid) > 0.0
        assert pid in latency._family(os.getpid())
    assert latency.in_process(9, 1).cpu > 0.0


def test_the_cost_of_a_start_is_that_of_all_processes_and_compiled_loops_are_counted(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    found = {row.what: row for row in cold_start.rows(["commands"], 1)}
    assert {*found} == {"import equimesh", "equimesh --help", "equimesh config"}
    assert all(0.0 < row.value < 100.0 and row.goal is not None for row in found.values())
    burn = "import time\nwhile time.process_time() < 0.3: pass"
    child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {burn!r}])"
    assert cold_start._command(["-c", child]) > 0.3
    with pytest.raises(SystemExit, match="ended with status 3"):
        cold_start._command(["-c", "raise SystemExit(3)"])

    @contextmanager
    def service(*_: object, variables: dict[str, str]) -> Iterator[tuple[str, int]]:
        loops = Path(variables["EQUIMESH_CACHE_DIR"], "level")
        loops.mkdir(exist_ok=True)
        for name in ("new-b-c", "again-b-c", ".new-b-c.lock"):
            (loops / name).touch()
        yield "", os.getpid()

    (tmp_path / "level").mkdir()
    for name in ("again-b-c", "kept-b-c"):
        (tmp_path / "level" / name).touch()
        os.utime(tmp_path / "level" / name, (0, 0))
    monkeypatch.setattr(cold_start, "service", service)
    seconds, compiled = cold_start.start(tmp_path, {})
    assert seconds > 0.0
    assert compiled == 2


@pytest.mark.parametrize(
    "equation",
    [{}, {"reaction": 3.0}, {"is_nonlinear": True}, {"diffusion": 0.1, "stream": (1.0, 0.5)}, {"domain": "L"}],
)
@pytest.mark.parametrize(("degree", "elements_of"), [(1, refinement.Elements.of), (2, BiquadraticElements.of)])
def test_the_elements_against_refinement_converge(
    degree: int, elements_of: Callable[..., Any], equation: dict[str, object]
) -> None:
    problem = refinement.Problem(u="sin(2*x + y)", **equation)
    errors = []
    for cells in (8, 16):
        domain, points = refinement.domain_of(problem, cells)
        mesh = domain.mesh if points is None else em.Mesh.uniform(em.Grid(points))
        elements = elements_of(problem, mesh)
        errors.append(elements.errors(elements.solve()))
    orders = [math.log2(coarse / fine) for coarse, fine in zip(*errors, strict=True)]
    assert degree + 0.7 < orders[0] < degree + 1.7  # of an L the finer mesh has a little more than twice the cells
    assert degree - 0.1 < orders[1] < degree + 0.5


def test_the_error_of_a_functional_is_near_the_estimate() -> None:
    problem = goals.PROBLEMS["point"]
    mesh = goals.ring((4, 4, 5, 7)).mesh
    found = goal_values(problem.solve(mesh), mesh, problem.goal)
    assert found.error is not None
    assert 0.8 < found.error / (problem.exact - found.value) < 1.25
