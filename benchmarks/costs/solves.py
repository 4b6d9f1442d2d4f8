"""Times of solves in this process: a large mesh, two threads, a small mesh."""

import math
import time
from collections.abc import Iterator
from dataclasses import astuple, dataclass
from statistics import median

import numpy as np

import equimesh as em
from costs.rows import Row, cpu_seconds
from equimesh.meshes.nested import distance, refinement

# As steep as tanh at half the cost: about 10 ns per point.
CHEAP = "20*(x + y/2 - 0.75) / sqrt(1 + (20*(x + y/2 - 0.75))**2)"
TANH = "tanh(20*(x + y/2 - 0.75))"
# Goals are for this many points a side, and for these.
LARGE = 1025
CPU_GOALS = {em.Mode.DISCRETIZATION: 220.0, em.Mode.TIGHT: 400.0}
WALL_GOALS = {33: 2.0, 65: 5.0}
SPEEDUP_GOAL = 1.7
ERROR_SHARE = 0.2
"""Goal of the algebraic error, as a share of the discretisation error."""
THREAD_RUNS, SMALL_RUNS = 7, 50


def front(n: int, u: em.Field | None = None) -> em.Problem:
    """A steep oblique front on ``n`` x ``n`` points, by default the :data:`CHEAP` one."""
    field = em.Expression(CHEAP) if u is None else u
    return em.Problem(monitor=em.ArcLength(u=field), grid=em.Grid(n_xi=n, n_eta=n))


def sweeps(problem: em.Problem, mode: em.Mode = em.Mode.DISCRETIZATION) -> dict[str, int]:
    """The sweeps (or Newton steps) of a solve on every grid, by points a side."""
    steps: dict[str, int] = {}

    def observe(event: em.Event) -> None:
        if isinstance(event, em.Step):
            steps[str(max(event.grid.shape))] = event.step

    em.solve(problem, mode=mode, threads=1, observe=observe)
    return steps


def cost_of(u: em.Field) -> Row:
    """The cost of a value of u, on as many points as a sweep evaluates at once."""
    x, y = np.random.default_rng(0).random((2, 32, 1024))
    seconds, _ = cpu_seconds(lambda: u.evaluate(x, y), runs=50)
    return Row(what="a value of u", value=1e9 * seconds / x.size, unit="ns/point", note=f"u = {getattr(u, 'text', u)}")


def large(n: int, u: em.Field | None = None, name: str = "") -> Iterator[Row]:
    """CPU time per point in both modes, and the errors of the first mode."""
    problem = front(n, u)
    found = {}
    for mode in em.Mode:
        counts = sweeps(problem, mode)
        seconds, found[mode] = cpu_seconds(lambda mode=mode: em.solve(problem, mode=mode, threads=1))  # type: ignore[misc]
        goal = CPU_GOALS[mode] if n == LARGE and u is None else None
        value = 1e9 * seconds / problem.grid.points
        yield Row(what=f"n = {n}, {mode}{name}", value=value, unit="ns/point", goal=goal, counts=counts)
    if u is None:
        yield errors(found[em.Mode.DISCRETIZATION], found[em.Mode.TIGHT])


def errors(solution: em.Solution, tight: em.Solution) -> Row:
    """The real algebraic error over the real discretisation error, from the mesh on a grid of half the spacing."""
    n = solution.problem.grid.n_xi
    finer = em.solve(front(2 * n - 1, solution.problem.monitor.u), mode=em.Mode.TIGHT, threads=1)
    algebraic = distance(solution.reference, tight.reference)
    share = 1.0 - 1.0 / refinement(finer.reference.grid, tight.reference.grid)
    real = distance(finer.reference, tight.reference) / share
    estimated = (solution.algebraic_error or math.nan, solution.discretization_error or math.nan)
    note = f"real {algebraic:.1e} of {real:.1e}; estimated {estimated[0]:.1e} of {estimated[1]:.1e}"
    what = f"n = {n}, algebraic over discretisation error"
    return Row(what=what, value=algebraic / real, unit="", goal=ERROR_SHARE, note=note)


def threads(n: int) -> Iterator[Row]:
    """Times on one thread over those on two: the best of alternating runs, since machines are shared.

    Wall times need two free cores. The processor time of the busier thread hardly does: it is that of a machine whose
    threads never wait. What only one thread does is the difference of the two threads.
    """
    problem = front(n)
    for mode in em.Mode:
        one, two = _Times(), _Times()
        for _ in range(THREAD_RUNS):
            one.add(problem, mode, 1)
            two.add(problem, mode, 2)
        goal, what = SPEEDUP_GOAL if n == LARGE else None, f"n = {n}, {mode}, two threads against one"
        note = f"{1e3 * one.wall:.0f} and {1e3 * two.wall:.0f} ms; needs two free cores"
        yield Row(what=what, value=one.wall / two.wall, unit="x", goal=goal, at_least=True, note=note)
        alone = not_shared(two.busier, two.all)
        note = f"{100 * alone:.1f} % of the work is not shared: at most {2.0 / (1.0 + alone):.2f} x"
        what = f"n = {n}, {mode}, CPU time of the busier one"
        yield Row(what=what, value=one.all / two.busier, unit="x", note=note)


def not_shared(busier: float, both: float) -> float:
    """Share of the work that only one of two threads does, from the processor times of the busier one and of both."""
    return max(0.0, 2.0 * busier - both) / both


@dataclass
class _Times:
    """The shortest times of some solves: wall time, processor time of the calling thread, and of all threads."""

    wall: float = math.inf
    busier: float = math.inf
    all: float = math.inf

    def add(self, problem: em.Problem, mode: em.Mode, count: int) -> None:
        """One more solve on ``count`` threads. The calling thread has a share of all work, and the rest of it."""
        before = time.perf_counter(), time.thread_time(), time.process_time()
        em.solve(problem, mode=mode, threads=count)
        after = time.perf_counter(), time.thread_time(), time.process_time()
        found = [min(b - a, known) for a, b, known in zip(before, after, astuple(self), strict=True)]
        self.wall, self.busier, self.all = found


def small(n: int) -> Iterator[Row]:
    """Wall time of a whole call, from an expression and from samples of it."""
    axis = np.linspace(0.0, 1.0, 65)
    expression = em.Expression(TANH)
    values = expression.evaluate(*np.meshgrid(axis, axis, indexing="ij"))[0]
    samples = em.GridSamples(x=axis, y=axis, values=values)
    for name, u in (("expression", expression), ("65 x 65 samples", samples)):
        problem = front(n, u)
        counts = sweeps(problem)
        seconds, cpu, best = _call_times(problem, SMALL_RUNS)
        what = f"n = {n}, {name}, the whole call"
        note = f"best {1e3 * best:.1f} ms, CPU time {1e3 * cpu:.1f} ms"
        yield Row(what=what, value=1e3 * seconds, unit="ms", goal=WALL_GOALS.get(n), counts=counts, note=note)


def _call_times(problem: em.Problem, runs: int) -> tuple[float, float, float]:
    """Median wall time of a call, its median CPU time, and the shortest wall time."""
    walls, cpus = [], []
    for _ in range(runs):
        wall, cpu = time.perf_counter(), time.process_time()
        em.solve(problem)
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    return median(walls), median(cpus), min(walls)
