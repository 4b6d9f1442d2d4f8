"""Line corrections of a merged mesh whose windows several processes hold.

Every subdomain corrects its part of all grid lines. From its neighbours it gets the sums of the metric lengths beyond,
how far the moving sides of the grid push the ends of each line, and afterwards the nodes beyond its interfaces.
"""

import numpy as np

from equimesh.equations.problem import Problem
from equimesh.meshes.folding import smallest_jacobian
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.parts import Parts
from equimesh.numerics.types import Array, Pair
from equimesh.schwarz.holding.on_channel import OnChannel
from equimesh.schwarz.lines.line_sums import HeldLineSums
from equimesh.schwarz.window import AXES, ENDS
from equimesh.sweeps.line_sums import cell_metrics
from equimesh.sweeps.sides import SideNodes, Sides
from equimesh.sweeps.sweep import Correction, Sweep, memory_needed


class HeldSweep:
    """Corrections of all grid lines, as :class:`~equimesh.sweeps.sweep.Sweep`, in the windows that are held here."""

    def __init__(self, problem: Problem, holding: OnChannel) -> None:
        self._problem, self._holding = problem, holding
        self._sums = HeldLineSums(problem, holding, holding.patches)
        windows = {k: holding.patches[k] for k in holding.numbers}
        # The windows are corrected one after the other, in the same memory.
        memory = np.empty(max(memory_needed(window.shape) for window in windows.values()))
        points = problem.grid.shape
        self._sweeps, self._sides = dict[int, Sweep](), dict[int, Sides]()
        for k, window in windows.items():
            frame = window.frame(points)
            self._sweeps[k] = Sweep(problem.metric, problem.boundary, Parts.of(window.shape), memory, frame)
            self._sides[k] = Sides(problem.metric, problem.boundary, window.shape, frame)
        self._moved = Mesh(np.empty((1, holding.size)), np.empty((1, holding.size)))
        self.smallest_jacobian = np.nan
        """The smallest corner Jacobian of the moved nodes, not scaled by the spacing; NaN where one is not finite."""

    def correct(self, x: Array, y: Array) -> Correction:
        """One correction of a merged mesh."""
        mesh, holding = Mesh(x, y), self._holding
        self._sums.read(mesh)
        rests = {k: self._rest(k) for k in holding.numbers}
        pushes = self._pushes(mesh, rests)
        found = {}
        for k, sweep in self._sweeps.items():
            view, moved = holding.view(mesh, k), holding.view(self._moved, k)
            correction = sweep.correct(view.x, view.y, rests[k], pushes[k])
            moved.x[:], moved.y[:] = sweep.new_x, sweep.new_y
            window = holding.patches[k]
            here = window.local(window.covered)
            smallest = smallest_jacobian(moved.x[here].copy(), moved.y[here].copy())
            found[k] = [correction.deviation, correction.move, -float(smallest)]
        holding.fill_ghosts(self._moved, "corrections")
        deviation, move, smallest = np.max(holding.every(found), axis=0).tolist()
        self.smallest_jacobian = -smallest
        return Correction(deviation, move)

    def swap(self, x: Array, y: Array) -> Pair:
        """The moved nodes; ``x`` and ``y`` are the memory for the next ones."""
        moved, self._moved = self._moved, Mesh(x, y)
        return moved.x, moved.y

    def _rest(self, k: int) -> Pair:
        """The sums beyond a window at both ends of its xi-lines and of its eta-lines."""
        window = self._holding.patches[k]
        found = np.zeros((2, window.shape[1])), np.zeros((2, window.shape[0]))
        for (axis, end), is_open in window.open.items():
            if is_open:
                found[axis][end] = self._sums.beyond(window, axis, end)
        return found

    def _pushes(self, mesh: Mesh, rests: dict[int, Pair]) -> dict[int, Pair]:
        """What the sides of the grid add to both ends of the lines of every window that ends at an interface."""
        holding = self._holding
        found, moves = dict[int, Pair](), dict[int, Pair]()
        for k in holding.numbers:
            view, shape = holding.view(mesh, k), holding.patches[k].shape
            *_, along_eta, along_xi = self._sides[k].moves(SideNodes.of(view.x, view.y), rest=rests[k])
            moves[k] = along_eta.copy(), along_xi.copy()
            found[k] = np.zeros((2, shape[1])), np.zeros((2, shape[0]))
        for axis in AXES:
            for end in ENDS:

                def first(k: int, axis: int = axis, end: int = end) -> Array:
                    return self._push(holding.view(mesh, k), moves[k][axis][end], axis, end)

                passed = holding.along_lines(axis, end, first, lambda _, received: received, "pushes")
                for k, push in passed.items():
                    if holding.patches[k].open[axis, end]:
                        found[k][axis][end] = push
        return found

    def _push(self, mesh: Mesh, moves: Array, axis: int, end: int) -> Array:
        """``-2 P`` at a side of the grid, or ``-2 Q``, for the lines that end there; its nodes move by ``moves``."""
        place = slice(-2, None) if end else slice(0, 2)
        x, y = (np.ascontiguousarray(q[place] if axis == 0 else q[:, place]) for q in (mesh.x, mesh.y))
        cells = np.empty((3, x.shape[0] - 1, x.shape[1] - 1))
        cell_metrics(self._problem.metric, x, y, cells)
        cells = cells.reshape(3, -1)
        m11, m12, m22 = 0.5 * (cells[:, 1:] + cells[:, :-1])
        gx, gy = (np.diff(q, axis=axis).ravel()[1:-1] for q in (x, y))
        along = m12 * gx + m22 * gy if axis == 0 else m11 * gx + m12 * gy
        push = np.zeros(moves.size)
        push[1:-1] = -2.0 * along * moves[1:-1]
        return push
