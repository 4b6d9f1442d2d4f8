"""Adapting with u unknown against refinement: relative errors of bilinear elements with equally many unknowns.

Problems of W. F. Mitchell, *A collection of 2D elliptic problems for testing adaptive algorithms* (NISTIR 7668, 2010),
and others with a steep feature that the first mesh does not see. Dirichlet data on all sides; the load is a(u, v) with
the exact gradient. Relative errors are in the L2 and in the full H1 norm, by a quadrature of its own.

    python benchmarks/refinement.py                         all problems, about 1,000 unknowns: a minute
    python benchmarks/refinement.py --unknowns 4000 --only 01 04
    python benchmarks/refinement.py --norm h1 --only 07     every round of a loop
    python benchmarks/refinement.py --movement              the Helmholtz demo of Firedrake's movement
    python benchmarks/refinement.py --floor                 the least errors with u known
    python benchmarks/refinement.py --degree-2              biquadratic elements alone
    python benchmarks/refinement.py --unknowns 1000 4000 --write
"""

from __future__ import annotations

import argparse
import io
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import skfem
from biquadratic_elements import NEWTON_STEPS, BiquadraticElements
from matplotlib.collections import LineCollection
from PIL import Image
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu
from skfem.helpers import dot, grad

import equimesh as em

SOLVE_POINTS, ERROR_POINTS = 6, 12
"""Gauss points a direction and cell of matrices and loads, and of errors."""
MAX_CHUNK = 200_000
"""Points at which u is evaluated at once."""
MAX_ROUNDS = 5
LARGE = 3000
"""Unknowns from which on errors of others are those with about 4,000 of them."""
CORNER = "(x**2 + y**2 + 1e-30)**(1/3)*sin(2/3*(atan2(-x - y, y - x) + 3*pi/4))"
"""The function of a corner that turns inwards; the missing quadrant is x > 0 > y."""


class Published(NamedTuple):
    """Errors of others, in percent of the H1 norm, with about 1,000 and 4,000 unknowns; NaN where none are known."""

    small: float
    large: float


class Remeshed(NamedTuple):
    """Relative errors in L2 and H1 of a loop of five passes that remeshes with Mmg, linear triangles."""

    l2: float
    h1: float


@dataclass(frozen=True, kw_only=True)
class Problem:
    """``-div(a grad u) + b . grad(u) + c u = f`` with the solution ``u``, an expression in x and y."""

    u: str
    domain: Literal["square", "box", "L"] = "square"
    diffusion: float = 1.0
    stream: tuple[float, float] = (0.0, 0.0)
    reaction: float = 0.0
    is_nonlinear: bool = False
    """Whether a is 1 + u^2."""
    power: int = 1
    """The power of the substitution in the quadrature along xi: above 1 for a gradient that is infinite at x = 0."""
    refined: Published | None = None
    """Anisotropic refinement of bilinear elements by Hermes: https://github.com/hpfem/hermes-examples, ``conv_dof``."""
    refined_twice: Published | None = None
    """The same of biquadratic elements."""
    remeshed: tuple[Remeshed, Remeshed] | None = None
    """A loop with Mmg, measured with the same unknowns on a machine of two cores."""


UNKNOWN = Remeshed(math.nan, math.nan)
PROBLEMS = {
    "01": Problem(
        u="2**40*(x*(1 - x)*y*(1 - y))**10", refined=Published(4.26, 2.13), refined_twice=Published(0.709, 0.157)
    ),
    "02": Problem(
        u=CORNER,
        domain="L",
        refined=Published(0.876, 0.439),
        refined_twice=Published(0.110, math.nan),
        remeshed=(UNKNOWN, Remeshed(1.2e-4, 1.3e-2)),
    ),
    "04": Problem(
        u="exp(-1000*((x - 0.5)**2 + (y - 0.5)**2))",
        refined=Published(4.44, 2.17),
        refined_twice=Published(0.750, 0.187),
        remeshed=(UNKNOWN, Remeshed(7.4e-4, 2.6e-2)),
    ),
    "07": Problem(
        u="(x + 1e-12)**0.6", power=6, refined=Published(1.46, math.nan), refined_twice=Published(1.47, math.nan)
    ),
    "09": Problem(
        u="atan(50*(sqrt((x - 0.5)**2 + (y - 0.5)**2) - 0.25))",
        refined=Published(8.50, 4.27),
        refined_twice=Published(3.61, 0.821),
    ),
    "LB": Problem(
        u="(1 - cosh(100*x)/cosh(100))*(1 - cosh(100*y)/cosh(100))",
        domain="box",
        reaction=1e4,
        refined=Published(3.65, 1.25),
        refined_twice=Published(2.20, 0.204),
    ),
    "peak": Problem(u="exp(-1e5*((x - 0.51)**2 + (y - 0.117)**2))", remeshed=(Remeshed(3.4e-3, 5.4e-2), UNKNOWN)),
    "steep": Problem(
        u="atan(1000*(sqrt((x + 0.05)**2 + (y + 0.05)**2) - 0.7))",
        remeshed=(Remeshed(3.3e-3, 0.15), Remeshed(1.0e-3, 6.2e-2)),
    ),
    "12": Problem(
        u=f"{CORNER} + exp(-1000*((x + sqrt(5)/4)**2 + (y + 0.25)**2))"
        " + atan(200*(sqrt(x**2 + (y + 0.75)**2) - 0.75)) + exp(-100*(1 + y))",
        domain="L",
        remeshed=(Remeshed(2.7e-3, 0.14), Remeshed(6.0e-4, 6.0e-2)),
    ),
    "skew": Problem(u="(1 + tanh(150*(y - x/2 - 0.25)))/2*(1 - exp((x - 1)/1e-3))", diffusion=1e-3, stream=(1.0, 0.5)),
    "ridge": Problem(u="exp(-2000*(y - 0.5 - 0.25*sin(2*pi*x))**2)", is_nonlinear=True),
}
"""The names of the collection, and words for the others."""


def domain_of(problem: Problem, cells: int) -> tuple[Any, int | None]:
    """The domain with about ``cells`` squared cells, and the points a side; None on blocks, which have their own."""
    if problem.domain != "L":
        box = (-1.0, 1.0) if problem.domain == "box" else (0.0, 1.0)
        return em.Rectangle(x=box, y=box), cells + 1
    side = round(cells * 36 / 64)
    vertices = {f"{x}{y}": [x - 1, y - 1] for x in range(3) for y in range(3) if (x, y) != (2, 0)}
    corners = (("00", "10", "11", "01"), ("01", "11", "12", "02"), ("11", "21", "22", "12"))
    blocks = [{"corners": list(names), "cells": [side, side]} for names in corners]
    return em.Blocks.of({"vertices": vertices, "blocks": blocks}), None


# Bilinear elements on any mesh of quadrilaterals.


class Quadrature(NamedTuple):
    """Points of all cells, ``(points, cells)``, with their weights and the slopes of the four shape functions."""

    x: np.ndarray
    y: np.ndarray
    weights: np.ndarray
    shape: np.ndarray
    """``(4, points, 1)``."""
    slopes: np.ndarray
    """``(2, 4, points, cells)``."""


def quadrature(nodes: np.ndarray, cells: np.ndarray, points: int, power: int) -> Quadrature:
    """A Gauss rule of some ``cells``, of ``points`` a direction."""
    at, w = np.polynomial.legendre.leggauss(points)
    at, w = 0.5 * (at + 1.0), 0.5 * w
    s, t = (q.ravel()[:, None] for q in np.meshgrid(at**power, at, indexing="ij"))
    weights = np.outer(power * at ** (power - 1) * w, w).ravel()[:, None]
    shape = np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t])
    by_s, by_t = np.stack([t - 1, 1 - t, t, -t]), np.stack([s - 1, -s, s, 1 - s])
    corners = nodes[cells].transpose(2, 1, 0)[:, :, None, :]  # (2, 4, 1, cells)
    (x, y), (x_s, y_s), (x_t, y_t) = ((corners * part).sum(axis=1) for part in (shape, by_s, by_t))
    det = x_s * y_t - x_t * y_s
    slopes = np.stack([(by_s * y_t - by_t * y_s) / det, (by_t * x_s - by_s * x_t) / det])
    return Quadrature(x, y, weights * det, shape, slopes)


@dataclass(frozen=True)
class Elements:
    """A mesh, and the equation of ``problem`` on it."""

    problem: Problem
    nodes: np.ndarray
    cells: np.ndarray
    is_fixed: np.ndarray
    node_shape: tuple[int, ...]

    @classmethod
    def of(cls, problem: Problem, mesh: Any) -> Elements:
        """The elements of a mesh of a grid or of blocks; all nodes on the sides are fixed."""
        is_fixed = np.zeros(len(mesh.points), dtype=bool)
        for side in mesh.sides.values():
            is_fixed[np.ravel(side)] = True
        return cls(problem, np.asarray(mesh.points), np.asarray(mesh.cells), is_fixed, mesh.node_shape)

    @property
    def unknowns(self) -> int:
        """The number of free unknowns."""
        return int((~self.is_fixed).sum())

    def returned(self, values: np.ndarray) -> np.ndarray:
        """What a solver returns to `em.adapt`."""
        return values.reshape(self.node_shape)

    def chunks(self, points: int) -> Iterator[tuple[np.ndarray, Quadrature]]:
        """Some cells at a time with their quadrature."""
        size = max(1, MAX_CHUNK // points**2)
        for first in range(0, len(self.cells), size):
            some = self.cells[first : first + size]
            yield some, quadrature(self.nodes, some, points, self.problem.power)

    def solve(self) -> np.ndarray:
        """The values at all nodes."""
        values = em.Expression(self.problem.u).evaluate(*self.nodes.T)[0]
        free = np.flatnonzero(~self.is_fixed)
        if self.problem.is_nonlinear:
            values[free] = 0.0
        for _ in range(NEWTON_STEPS if self.problem.is_nonlinear else 1):
            matrix, rest = self.assembled(values)
            step = splu(matrix[free][:, free].tocsc()).solve(rest[free])
            values[free] += step
            if np.abs(step).max() <= 1e-10 * np.abs(values).max():
                break
        return values

    def assembled(self, values: np.ndarray) -> tuple[csc_matrix, np.ndarray]:
        """The matrix of the linear equation at ``values``, and what is left of the load there."""
        count, problem, u = len(self.nodes), self.problem, em.Expression(self.problem.u)
        rest, parts = np.zeros(count), []
        has_stream = any(problem.stream)
        for cells, at in self.chunks(SOLVE_POINTS):
            exact, x, y, *bends = u.evaluate(at.x, at.y, order=2 if has_stream else 1)
            own = values[cells].T[:, None, :]
            here = (own * at.shape).sum(axis=0)
            h_x, h_y = (own * at.slopes).sum(axis=1)
            a, a_exact, slope = problem.diffusion, problem.diffusion, 0.0
            if problem.is_nonlinear:
                a, a_exact, slope = 1.0 + here**2, 1.0 + exact**2, 2.0 * here
            flux = a_exact * x - a * h_x, a_exact * y - a * h_y
            b, c = problem.stream, problem.reaction
            other = c * (exact - here) + b[0] * (x - h_x) + b[1] * (y - h_y)
            test = at.shape
            along = b[0] * at.slopes[0] + b[1] * at.slopes[1]
            if has_stream:
                tau = supg_parameter(self.nodes[cells], along, problem)
                test = at.shape + tau * along
                bend = problem.diffusion * (bends[0] + bends[2])
                extra = tau * along * (other - bend)
            local = other * at.shape + flux[0] * at.slopes[0] + flux[1] * at.slopes[1]
            local = local + extra if has_stream else local
            np.add.at(rest, cells.T, (local * at.weights).sum(axis=1))
            w = at.weights[None, None]
            grads = (at.slopes[:, :, None] * at.slopes[:, None, :]).sum(axis=0)
            matrix = a * grads + c * at.shape[:, None] * at.shape[None] + test[:, None] * along[None, :]
            if problem.is_nonlinear:
                across = h_x * at.slopes[0] + h_y * at.slopes[1]
                matrix = matrix + slope * across[:, None] * at.shape[None]
            parts.append((cells, (matrix * w).sum(axis=2)))
        cells = np.concatenate([part for part, _ in parts])
        entries = np.concatenate([part for _, part in parts], axis=2)
        rows, columns = np.broadcast_arrays(cells.T[:, None], cells.T[None])
        return csc_matrix((entries.ravel(), (rows.ravel(), columns.ravel())), shape=(count, count)), rest

    def errors(self, values: np.ndarray) -> tuple[float, float]:
        """The relative errors of nodal values in L2 and in the full H1 norm."""
        u, sums = em.Expression(self.problem.u), np.zeros(4)
        for cells, at in self.chunks(ERROR_POINTS):
            exact, x, y = u.evaluate(at.x, at.y, order=1)
            own = values[cells].T[:, None, :]
            error = exact - (own * at.shape).sum(axis=0)
            h_x, h_y = (own * at.slopes).sum(axis=1)
            parts = error**2, (x - h_x) ** 2 + (y - h_y) ** 2, exact**2, x**2 + y**2
            sums += [float((part * at.weights).sum()) for part in parts]
        return math.sqrt(sums[0] / sums[2]), math.sqrt((sums[0] + sums[1]) / (sums[2] + sums[3]))


def supg_parameter(corners: np.ndarray, along: np.ndarray, problem: Problem) -> np.ndarray:
    """The parameter of each cell, bounded by the thickness of the cell; see the page on SUPG."""
    eps, speed = problem.diffusion, float(np.hypot(*problem.stream))
    length = 2.0 * speed / np.abs(along).sum(axis=0).mean(axis=0)
    peclet = speed * length / (2.0 * eps)
    tau = length / (2.0 * speed) * (1.0 / np.tanh(peclet) - 1.0 / peclet)
    a = 0.5 * (corners[:, 1] + corners[:, 2] - corners[:, 0] - corners[:, 3])
    b = 0.5 * (corners[:, 2] + corners[:, 3] - corners[:, 0] - corners[:, 1])
    thickness = np.linalg.svd(np.stack([a, b], axis=1), compute_uv=False)[:, -1]
    return np.minimum(tau, thickness**2 / (12.0 * eps))


# The loop.


class Looped(NamedTuple):
    """A loop with the errors of all its rounds, the CPU seconds of adapting, and the number of free unknowns."""

    found: em.Adaptation
    errors: list[tuple[float, float]]
    seconds: float
    unknowns: int


def loop(
    problem: Problem,
    cells: int,
    norm: Literal["l2", "h1"],
    rounds: int = MAX_ROUNDS,
    finds_shape: bool = False,
    elements_of: Callable[[Problem, Any], Elements | BiquadraticElements] = Elements.of,
    **options: Any,
) -> Looped:
    """The loop on a mesh with about ``cells`` squared cells, whose shape it finds where requested."""
    domain, side = domain_of(problem, cells)
    if finds_shape and side is not None:
        options, side = {**options, "points": side**2}, None
    spent, errors, unknowns = [0.0], [], [0]

    def solve(mesh: Any) -> Any:
        begun = time.process_time()
        elements = elements_of(problem, mesh)
        values = elements.solve()
        errors.append(elements.errors(values))
        unknowns[0] = elements.unknowns
        spent[0] += time.process_time() - begun
        return elements.returned(values)

    begun = time.process_time()
    found = em.adapt(solve, side, domain=domain, rounds=rounds, norm=norm, threads=1, **options)
    return Looped(found, errors, time.process_time() - begun - spent[0], unknowns[0])


# The least error that a mesh of so many lines has, as far as descents with u known find it.

FLOOR_WEIGHTS = ((0.5, 0.1), (0.2, 0.3), (0.1, 0.03))
"""Distortion and smoothness of the descents."""


def floor(problem: Problem, cells: int) -> float:
    """The least relative L2 error of a solver on meshes that are made with u known."""
    domain, side = domain_of(problem, cells)
    grid = {} if side is None else {"grid": em.Grid(side)}
    found = []
    for distortion, smoothness in FLOOR_WEIGHTS:
        monitor = em.LeastError(
            em.Expression(problem.u), distortion=distortion, smoothness=smoothness, purpose="finite_element"
        )
        mesh = em.solve(em.Problem(monitor, domain=domain, **grid), check=False, threads=1).mesh
        elements = Elements.of(problem, mesh)
        found.append(elements.errors(elements.solve())[0])
    return min(found)


def floor_rows(names: list[str], counts: list[int]) -> Iterator[str]:
    """The table of the least errors, next to those of Mmg."""
    yield "| problem, unknowns about | best mesh with u known, L2 | Mmg, L2 | ratio |"
    yield "|---|---|---|---|"
    for name in names:
        for count in counts:
            others = (PROBLEMS[name].remeshed or (UNKNOWN, UNKNOWN))[count >= LARGE].l2
            if math.isfinite(others):
                least = floor(PROBLEMS[name], math.ceil(math.sqrt(count)))
                yield f"| {name}, {count} | {percent(least)} | {percent(others)} | {least / others:.2g} |"


# The Helmholtz demo of Firedrake's movement: triangles on 21 x 21 nodes.

DEMO = "exp(-((x - 0.51)**2 + (y - 0.65)**2)/0.01)"
DEMO_POINTS = 21
DEMO_PUBLISHED = {"uniform": 0.010234, "moved by the exact Hessian": 5.96e-3, "moved, u unknown": 6.22e-3}
"""L2 errors in the demo: https://github.com/mesh-adaptation/movement, ``demos/monge_ampere_helmholtz.py``."""


def demo_solve(mesh: em.Mesh) -> np.ndarray:
    """Linear elements for ``-Laplace(u) + u = f`` with the values of u on the sides."""
    basis = skfem.Basis(mesh.to_skfem(cells="triangle"), skfem.ElementTriP1(), intorder=6)
    u = em.Expression(DEMO)
    exact, x, y = u.evaluate(*basis.global_coordinates(), order=1)
    matrix = skfem.BilinearForm(lambda v, w, _: dot(grad(v), grad(w)) + v * w).assemble(basis)
    load = skfem.LinearForm(lambda w, at: at.x_ * grad(w)[0] + at.y_ * grad(w)[1] + at.u * w)
    right = load.assemble(basis, x_=x, y_=y, u=exact)
    values = u.evaluate(mesh.x.ravel(), mesh.y.ravel())[0]
    return skfem.solve(*skfem.condense(matrix, right, x=values, D=basis.get_dofs()))


def demo_error(mesh: em.Mesh, values: np.ndarray) -> float:
    """The L2 error of linear elements."""
    basis = skfem.Basis(mesh.to_skfem(cells="triangle"), skfem.ElementTriP1(), intorder=10)
    error = basis.interpolate(np.ravel(values)) - em.Expression(DEMO).evaluate(*basis.global_coordinates())[0]
    return float(np.sqrt((error**2 * basis.dx).sum()))


def demo_rows() -> Iterator[str]:
    """The table of the demo."""
    yield "| mesh of 21 x 21 nodes | L2 error |"
    yield "|---|---|"
    for name, error in DEMO_PUBLISHED.items():
        yield f"| movement: {name} | {error:.3g} |"
    grid = em.Grid(DEMO_POINTS)
    uniform = em.Mesh.uniform(grid)
    yield f"| equimesh: uniform | {demo_error(uniform, demo_solve(uniform)):.3g} |"
    given = em.solve(em.Problem(em.LeastError(em.Expression(DEMO), cells="triangle"), grid)).mesh
    yield f'| equimesh: `LeastError(u, cells="triangle")` | {demo_error(given, demo_solve(given)):.3g} |'
    found = em.adapt(demo_solve, DEMO_POINTS)
    yield f"| equimesh: `em.adapt`, u unknown | {demo_error(found.mesh, found.values):.3g} |"


# Tables.

PAGE = Path(__file__).resolve().parents[1] / "docs" / "background" / "against-refinement.md"
PICTURE = PAGE.parents[1] / "images" / "against-refinement.png"
BEGIN, END = "<!-- refinement.py: begin -->", "<!-- refinement.py: end -->"
DRAWN = ("07", "steep", "12")
"""Problems whose meshes are drawn."""


def percent(error: float | None) -> str:
    """A relative error in percent."""
    return "-" if error is None or not math.isfinite(error) else f"{100.0 * error:.3g}"


def table_rows(names: list[str], counts: list[int], rounds: int) -> Iterator[tuple[str, dict[str, Looped]]]:
    """The rows of the table, and the loops in H1 by which they were made."""
    head = (
        "problem, unknowns",
        "uniform, L2 / H1",
        "`em.adapt`, L2 / H1",
        'with `norm="h1"`',
        "refinement, H1",
        "Mmg, L2 / H1",
        "seconds of adapting",
    )
    yield f"| {' | '.join(head)} |", {}
    yield "|---" * len(head) + "|", {}
    for name in names:
        problem = PROBLEMS[name]
        for number, count in enumerate(counts):
            cells = math.ceil(math.sqrt(count))
            value = loop(problem, cells, "l2", rounds)
            slope = loop(problem, cells, "h1", rounds, finds_shape=True)
            is_large = count >= LARGE
            refined = problem.refined and problem.refined[is_large]
            others = problem.remeshed[is_large] if problem.remeshed else UNKNOWN
            at = [looped.errors[looped.found.best] for looped in (value, slope)]
            entries = (
                f"{name}, {value.unknowns}",
                pair(value.errors[0]),
                pair(at[0]),
                pair(at[1]) + shape_of(slope),
                percent(refined and refined / 100.0),
                pair(others),
                f"{value.seconds:.1f}/{slope.seconds:.1f}",
            )
            yield f"| {' | '.join(entries)} |", {name: slope if name == "07" else value} if number == 0 else {}


def degree_2_rows(names: list[str], counts: list[int], rounds: int) -> Iterator[str]:
    """The table of biquadratic elements, by loops in H1 that find the shape of the grid."""
    yield "| degree 2: problem, unknowns | uniform, H1 | `em.adapt`, H1 | refinement, H1 |"
    yield "|---|---|---|---|"
    for name in names:
        problem = PROBLEMS[name]
        for count in counts if problem.refined_twice else ():
            cells = round((math.sqrt(count) + 1) / 2)
            found = loop(problem, cells, "h1", rounds, finds_shape=True, elements_of=BiquadraticElements.of)
            refined = problem.refined_twice[count >= LARGE]
            (_, uniform), (_, slope) = found.errors[0], found.errors[found.found.best]
            entries = percent(uniform), percent(slope) + shape_of(found), percent(refined / 100.0)
            yield f"| {name}, {found.unknowns} | {' | '.join(entries)} |"


def shape_of(looped: Looped) -> str:
    """The points of a grid that the loop has chosen, where they are not as many both ways."""
    shape = looped.found.mesh.node_shape
    return "" if len(shape) == 1 or shape[0] == shape[1] else f" on {shape[0]} x {shape[1]}"


def pair(errors: tuple[float, float]) -> str:
    """Relative errors in L2 and H1, in percent."""
    return " / ".join(map(percent, errors)) if any(map(math.isfinite, errors)) else "-"


def draw(loops: dict[str, Looped]) -> None:
    """The picture of the meshes of three problems."""
    figure, panes = plt.subplots(1, len(DRAWN), figsize=(12.0, 5.0))
    for pane, name in zip(panes, DRAWN, strict=True):
        mesh = loops[name].found.mesh
        lines = LineCollection(mesh.points[mesh.cells[:, [0, 1, 2, 3, 0]]], colors="#345", linewidths=0.35)
        pane.add_collection(lines)
        pane.autoscale()
        pane.set_aspect("equal")
        pane.set_axis_off()
        pane.set_title(name, fontsize=10)
    figure.tight_layout()
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=110)
    Image.open(drawn).convert("L").quantize(16).save(PICTURE, optimize=True)  # lines need few shades


def write(*tables: list[str]) -> None:
    """Put all tables into the page."""
    before, rest = PAGE.read_text().split(BEGIN)
    after, text = rest.split(END)[1], "\n\n".join("\n".join(rows) for rows in tables)
    PAGE.write_text(f"{before}{BEGIN}\n\n{text}\n\n{END}{after}")


def every_round(name: str, looped: Looped) -> Iterator[str]:
    """What happened in every round."""
    for one, errors in zip(looped.found.rounds, looped.errors, strict=True):
        numbers = f"estimate {one.estimate:.2e}, unresolved {one.unresolved:.3f}, {one.start}"
        yield f"    {name} {one.number}: {pair(errors)} %, {numbers}"
    yield f"    {looped.found.reason}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=PROBLEMS, default=list(PROBLEMS), help="these problems")
    parser.add_argument("--unknowns", type=int, nargs="+", default=[1000], help="about so many unknowns")
    parser.add_argument("--norm", choices=("l2", "h1"), help="print every round of the loops in this norm, no table")
    parser.add_argument("--shape", action="store_true", help="with --norm: let the loop find the shape of the grid")
    parser.add_argument("--rounds", type=int, default=MAX_ROUNDS, help="rounds of the loop, at most")
    parser.add_argument("--movement", action="store_true", help="the Helmholtz demo of movement alone")
    parser.add_argument("--degree-2", action="store_true", help="biquadratic elements alone")
    parser.add_argument("--floor", action="store_true", help="the least errors with u known alone")
    parser.add_argument("--write", action="store_true", help="all tables and the picture, into the page of the docs")
    options = parser.parse_args()
    if options.norm:
        for count in options.unknowns:
            for name in options.only:
                cells = math.ceil(math.sqrt(count))
                looped = loop(PROBLEMS[name], cells, options.norm, options.rounds, finds_shape=options.shape)
                print(f"{name}, {looped.unknowns} unknowns: round {looped.found.best}, {looped.seconds:.1f} s")
                print("\n".join(every_round(name, looped)), flush=True)
        return
    rows, loops, demo, floors, twice = [], {}, [], [], []
    if not (options.movement or options.floor or options.degree_2):
        for row, made in table_rows(options.only, options.unknowns, options.rounds):
            print(row, flush=True)
            rows.append(row)
            loops.update(made)
    if options.movement or options.write:
        demo = list(demo_rows())
        print("\n".join(demo))
    if options.floor or options.write:
        floors = list(floor_rows(options.only, options.unknowns))
        print("\n".join(floors))
    if options.degree_2 or options.write:
        for row in degree_2_rows(options.only, options.unknowns, options.rounds):
            print(row, flush=True)
            twice.append(row)
    if options.write:
        write(rows, twice, floors, demo)
        draw(loops)


if __name__ == "__main__":
    main()
