"""The slowest errors of a Schwarz iteration with the optimized condition: those that alternate from line to line.

If the nodes of neighbouring xi-lines move in opposite directions, no eta-edge changes its length, and the xi-lines are
independent. The errors P of a line obey ``P_xi + d P = constant``; d is the effect of the metric on a line that bends.
It is measured here on the single-domain mesh, by such moves of its nodes. One iteration then is a small matrix on P for
every line. The eigenvalue of the worst line is printed next to the observed factor of the iteration, with strips in
parallel and without acceleration.

    python benchmarks/schwarz_modes.py --points 65
"""

from __future__ import annotations

import argparse
import itertools
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import schwarz_rates

Array = npt.NDArray[np.float64]
STRIPS, STEP = (2, 4, 8), 1e-7


def squared_lengths(metric: Any, x: Array, y: Array) -> tuple[Array, Array]:
    """Values of the xi-edges on all inner lines, shape ``(n_xi - 1, n_eta - 2)``, and the metric of the cells."""
    from equimesh.sweeps.line_sums import cell_metrics

    cells = np.empty((3, x.shape[0] - 1, x.shape[1] - 1))
    cell_metrics(metric, x, y, cells)
    m11, m12, m22 = 0.5 * (cells[:, :, 1:] + cells[:, :, :-1])
    dx, dy = np.diff(x, axis=0)[:, 1:-1], np.diff(y, axis=0)[:, 1:-1]
    return m11 * dx**2 + 2 * m12 * dx * dy + m22 * dy**2, cells


def moves(cells: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """The moves of the inner nodes for P = 1 and Q = 0."""
    inside = (slice(1, -1), slice(1, -1))
    m11, m12, m22 = 0.25 * (cells[:, 1:, 1:] + cells[:, 1:, :-1] + cells[:, :-1, 1:] + cells[:, :-1, :-1])
    (x_xi, x_eta), (y_xi, y_eta) = ([q[inside] for q in np.gradient(z)] for z in (x, y))
    a, b = m11 * x_xi + m12 * y_xi, m12 * x_xi + m22 * y_xi
    c, d = m11 * x_eta + m12 * y_eta, m12 * x_eta + m22 * y_eta
    found = np.zeros((2, *x.shape))
    found[0][inside], found[1][inside] = d / (a * d - b * c), -c / (a * d - b * c)
    return found[0], found[1]


def responses(metric: Any, x: Array, y: Array) -> Array:
    """Half the change of every xi-edge's squared length by the P of its two nodes, shape ``(2, edges, lines)``."""
    _, cells = squared_lengths(metric, x, y)
    along_x, along_y = moves(cells, x, y)
    sign = (-1.0) ** np.arange(x.shape[1])
    found = np.zeros((2, x.shape[0] - 1, x.shape[1] - 2))
    for parity in (0, 1):  # every other node, so that the two nodes of an edge stay apart
        p = STEP * sign * (np.arange(x.shape[0]) % 2 == parity)[:, None]
        up, _ = squared_lengths(metric, x + p * along_x, y + p * along_y)
        down, _ = squared_lengths(metric, x - p * along_x, y - p * along_y)
        change = (up - down) / (4 * STEP) * sign[1:-1]
        for edge in range(len(change)):
            found[int((edge + 1) % 2 == parity), edge] = change[edge]
    return found


def lengths(response: Array) -> Array:
    """The matrix from P at the nodes of one line to the lengths of its edges; ends of the line do not move."""
    edges = response.shape[1]
    found = np.zeros((edges, edges + 1))
    found[np.arange(edges), np.arange(edges)], found[np.arange(edges), np.arange(1, edges + 1)] = response
    found[:, [0, -1]] = 0.0
    return found


def iteration(changed: Array, spans: Sequence[Any], kind: str) -> Array:
    """One parallel iteration of strips on the P of one line, with the optimized or the classical condition."""
    edges = len(changed)
    found = np.zeros((edges + 1, edges + 1))
    for span in spans:
        first, size = span.first, span.size
        system, given = np.zeros((size + 1, size + 1)), np.zeros((size + 1, edges + 1))
        system[: size - 1, :size] = changed[first : span.last, first : span.last + 1]
        system[: size - 1, -1] = -1.0  # all edges of the window change alike
        for row, node, side in ((size - 1, first, -1), (size, span.last, 1)):
            rest = changed[node:] if side > 0 else changed[:node]
            system[row, node - first] = side if len(rest) else 1.0
            if len(rest) and kind == "classical":
                system[row, node - first], given[row, node] = 1.0, 1.0
            elif len(rest):  # the rest of the line changes by what the interface moves
                system[row, -1] = len(rest)
                given[row] = rest.sum(axis=0)
                given[row, node] += side
        solved = np.linalg.solve(system, given)
        owned = slice(span.owned_first, span.owned_last + 1)
        found[owned] = solved[span.owned_first - first : span.owned_last + 1 - first]
    return found


def correction(changed: Array) -> Array:
    """One line correction on the P of one line."""
    defects = changed.mean(axis=0) - changed
    found = np.eye(changed.shape[1])
    found[1:] += np.cumsum(defects, axis=0)
    found[[0, -1]] = 0.0
    return found


def predicted(name: str, n: int, strips: int, corrections: int, kind: str) -> tuple[complex, float]:
    """The largest eigenvalue over all lines, and its modulus for line corrections alone."""
    import equimesh as em

    problem, _, reference = schwarz_rates.case(name, n)
    spans = em.Schwarz(subdomains=(strips, 1), overlap=2).decompose(problem.grid).spans[0]
    found, alone = [], []
    for response in np.moveaxis(responses(problem.metric, reference.x, reference.y), 2, 0):
        changed = lengths(response)
        sweep = correction(changed)
        found += list(np.linalg.eigvals(np.linalg.matrix_power(sweep, corrections) @ iteration(changed, spans, kind)))
        alone.append(np.abs(np.linalg.eigvals(sweep)).max())
    return complex(max(found, key=abs)), float(max(alone))


def measured(name: str, n: int, strips: int, corrections: int, kind: str) -> tuple[float, float]:
    """The mean factor between the last errors, and the cosine between the last two: 1 or -1 for an eigenvector."""
    import equimesh as em
    from equimesh.schwarz.records import observed_rate

    problem, start, reference = schwarz_rates.case(name, n)
    settings = em.Schwarz(
        subdomains=(strips, 1),
        overlap=2,
        transmission=schwarz_rates.condition(kind),
        line_correction=corrections,
        acceleration=em.Acceleration.NONE,
        tolerance=None,
        fallback=False,
    )
    errors: list[Array] = []
    for record in itertools.islice(em.iterate(problem, settings, start), 25):
        mesh = record.reference
        errors.append(np.concatenate([(mesh.x - reference.x).ravel(), (mesh.y - reference.y).ravel()]))
        if np.abs(errors[-1]).max() < 1e-10:
            break
    rate = observed_rate([float(np.abs(e).max()) for e in errors], 0.0)
    before, after = (e / np.linalg.norm(e) for e in errors[-2:])
    return rate or 0.0, float(before @ after)


def main() -> None:
    os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=65, help="points a side")
    parser.add_argument("--kind", choices=("optimized", "classical"), default="optimized")
    parser.add_argument("--corrections", type=int, nargs="+", default=[0, 1], help="line corrections")
    options = parser.parse_args()
    print("| u | strips | line corrections | predicted | measured | cosine | line corrections alone, predicted |")
    for name, strips, corrections in itertools.product(schwarz_rates.NAMES, STRIPS, options.corrections):
        what = name, options.points, strips, corrections, options.kind
        value, alone = predicted(*what)
        rate, cosine = measured(*what)
        shown = f"{value.real:.3f}" if abs(value.imag) < 1e-3 else f"{value:.3f}, modulus {abs(value):.3f}"
        row = (name, strips, corrections, shown, f"{rate:.3f}", f"{cosine:.3f}", f"{alone:.3f}")
        print("| " + " | ".join(map(str, row)) + " |", flush=True)


if __name__ == "__main__":
    main()
