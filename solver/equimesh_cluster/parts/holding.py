"""The subdomains that one of several processes holds: the merged mesh in their windows, and its lines."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from equimesh.domains.domain import Domain, map_mesh
from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.meshes.mesh import Mesh, largest_difference, smallest_jacobian
from equimesh.meshes.rows import Rows
from equimesh.numerics.types import Array, IntArray, Pair
from equimesh.schwarz.decomposition import AXES, ENDS, Decomposition, Place, SubdomainWindow, common, rim
from equimesh.schwarz.line_corrections import LineCorrections, LineSums, Segments, added, interfaces, line_cuts
from equimesh.schwarz.merged_mesh import MergedMeshes, Numbers, WholeWork, product
from equimesh.sweeps.line_sums import cell_metrics
from equimesh.sweeps.sweep import Correction, Frame, SideNodes, Sides, Sweep, memory_needed
from equimesh_cluster.messages import Channel, Counted

# The subdomains that one of several processes holds, and the merged mesh in their windows.
#
# Processes exchange messages through a :class:`~equimesh_cluster.messages.Channel`. Each holds consecutive
# subdomains. A merged mesh is, for each of them, the nodes of its window with one grid line beyond every interface.
# Its arrays have the shape ``(1, nodes)``: the windows one after the other. Nodes that subdomains share are held by
# each of them.

# Grid lines beyond every interface that a process holds of a merged mesh.
GHOSTS = 1


class OnChannel(MergedMeshes):
    """The subdomains of one process.

    All processes call the same functions in the same order, and get the same numbers.
    """

    is_whole = False

    def __init__(self, channel: Channel, decomposition: Decomposition, *, shows: bool = False) -> None:
        """With ``shows`` the first process assembles the mesh of every record."""
        count = len(decomposition.parts)
        if channel.count > count:
            raise InputError(
                f"{channel.count} parts for {count} subdomains: every part needs a subdomain, so take at most"
                f" {count} parts, or more subdomains",
                field="parts",
            )
        super().__init__(decomposition)
        self.channel, self._shows = Counted(channel), shows
        self._holders = [holder(k, count, channel.count) for k in range(count)]
        self.numbers = [k for k in range(count) if self._holders[k] == channel.number]
        self.patches = [SubdomainWindow(decomposition, part, GHOSTS) for part in decomposition.parts]
        ends = np.cumsum([0, *(self.patches[k].shape[0] * self.patches[k].shape[1] for k in self.numbers)])
        self._places = {k: slice(int(a), int(b)) for k, a, b in zip(self.numbers, ends, ends[1:], strict=False)}
        self.size = int(ends[-1])

    def holder_of(self, k: int) -> int:
        """The part that holds a subdomain."""
        return self._holders[k]

    def held_by(self, part: int) -> list[int]:
        """The numbers of the subdomains that a part holds."""
        return [k for k, holder in enumerate(self._holders) if holder == part]

    @property
    def sent(self) -> dict[str, int]:
        """Bytes that this process has sent, by kind."""
        return {kind: traffic.bytes for kind, traffic in self.channel.sent.items()}

    def view(self, mesh: Mesh, k: int) -> Mesh:
        """The window of a subdomain in a merged mesh: the same memory."""
        shape, place = self.patches[k].shape, self._places[k]
        return Mesh(mesh.x[0, place].reshape(shape), mesh.y[0, place].reshape(shape))

    def joined(self, windows: Mapping[int, Mesh]) -> Mesh:
        """The merged mesh of the windows of the subdomains that are held here."""
        x, y = (np.concatenate([getattr(windows[k], q).ravel() for k in self.numbers]) for q in "xy")
        return Mesh(x[None], y[None])

    def cut(self, whole: Mesh) -> Mesh:
        """The merged mesh of a mesh of the whole grid."""
        return self.joined({k: self.patches[k].restrict(whole) for k in self.numbers})

    def restrict(self, window: SubdomainWindow, mesh: Mesh) -> Mesh:
        """A copy of the part of a merged mesh in the window of a subdomain that is held here."""
        k = window.part.number
        view, place = self.view(mesh, k), moved(window.slices, self.patches[k].first)
        return Mesh(view.x[place].copy(), view.y[place].copy())

    def merge(
        self,
        turn: Sequence[int],
        states: Mapping[int, Mesh],
        windows: Sequence[SubdomainWindow],
        places: Mapping[int, Place],
        reads: Sequence[SubdomainWindow],
        mesh: Mesh,
    ) -> None:
        """Write the nodes of all subdomains of a turn into the windows, in the order of the turn."""
        pairs = [(k, m) for k in turn for m in range(len(self.patches))]
        shared = {(k, m): common(places[k], places[k] if k == m else reads[m].slices) for k, m in pairs}
        found = {}
        for (k, m), place in shared.items():
            if place is not None:
                found[k, m] = self._nodes(k, m, states.get(k), windows[k], place, "nodes")
        for (k, m), nodes in found.items():
            place = shared[k, m]
            if nodes is not None and place is not None:
                view, local = self.view(mesh, m), self.patches[m].local(place)
                view.x[local], view.y[local] = nodes

    def fill_ghosts(self, mesh: Mesh, kind: str) -> None:
        """Take the grid lines beyond all interfaces from the neighbours that cover them."""
        found = {}
        for m, window in enumerate(self.patches):
            for step, place in rim(window).items():
                near = self.decomposition.at(window.part.place[0] + step[0], window.part.place[1] + step[1]).number
                state = self.view(mesh, near) if near in self._places else None
                found[m, step] = place, self._nodes(near, m, state, self.patches[near], place, kind)
        for (m, _), (place, nodes) in found.items():
            if nodes is not None:
                view, local = self.view(mesh, m), self.patches[m].local(place)
                view.x[local], view.y[local] = nodes

    def close_sides(self, mesh: Mesh) -> None:
        """Put the nodes of the four sides on them exactly."""
        for k in self.numbers:
            view, window = self.view(mesh, k), self.patches[k]
            for q, axis in ((view.x, 0), (view.y.T, 1)):
                for end, line in ((0, 0), (1, -1)):
                    if not window.open[axis, end]:
                        q[line] = float(end)

    def every(self, numbers: Mapping[int, Numbers]) -> list[Numbers]:
        """The numbers of all subdomains, gathered in a tree and sent back: each message has numbers of several."""
        rows = np.array([[float(k), *numbers[k]] for k in self.numbers])
        here, count, step = self.channel.number, self.channel.count, 1
        while step < count:
            if here % (2 * step) == step:
                self.channel.send(here - step, "agreed", [rows])
            elif here % (2 * step) == 0 and here + step < count:
                rows = np.concatenate([rows, self.channel.receive(here + step, "agreed")[0]])
            step *= 2
        while step > 1:
            step //= 2
            if here % (2 * step) == step:
                rows = np.asarray(self.channel.receive(here - step, "agreed")[0])
            elif here % (2 * step) == 0 and here + step < count:
                self.channel.send(here + step, "agreed", [rows])
        return [row[1:].tolist() for row in rows]

    def mismatch(self, states: Mapping[int, Mesh], windows: Sequence[SubdomainWindow], mesh: Mesh) -> float:
        """The largest difference between a subdomain's solution and the merged mesh."""
        places = {k: windows[k].local(windows[k].covered) for k in self.numbers}
        return self._largest(lambda k: self._difference(states[k], places[k], self.view(mesh, k), self._covered(k)))

    def distance(self, one: Mesh, other: Mesh) -> float:
        """The largest difference of a coordinate between two merged meshes."""
        return self._largest(
            lambda k: self._difference(self.view(one, k), self._covered(k), self.view(other, k), self._covered(k))
        )

    def smallest_jacobian(self, mesh: Mesh, domain: Domain | None = None) -> float:
        """The smallest corner Jacobian; every cell lies in a subdomain."""
        found = {}
        for k in self.numbers:
            view, place = self.view(mesh, k), self._covered(k)
            part = Mesh(view.x[place].copy(), view.y[place].copy())
            part = part if domain is None else map_mesh(part, domain)
            found[k] = [float(smallest_jacobian(part.x, part.y))]
        return float(np.min(self.every(found)))

    def products(self, pairs: Sequence[tuple[Mesh, Mesh]]) -> Array:
        """The inner products, subdomain by subdomain."""
        found: dict[int, list[float]] = {}
        for k in self.numbers:
            place = self.patches[k].local(self.patches[k].part.owned)
            found[k] = [product(self.view(a, k), self.view(b, k), place) for a, b in pairs]
        return np.array([sum(column) for column in zip(*self.every(found), strict=True)])

    def on_whole(
        self, work: WholeWork, meshes: Sequence[Mesh], states: Sequence[Mesh] = ()
    ) -> tuple[Mesh | None, float]:
        """The result of the work, which the first process does."""
        whole = [self.assembled(mesh, "whole") for mesh in meshes]
        solved = self._gathered(states) if states else []
        number, result = np.zeros(2), None
        if self.channel.number == 0:
            result, value = work([mesh for mesh in whole if mesh is not None], solved)
            number[:] = value, float(result is not None)
            for to in range(1, self.channel.count):
                self.channel.send(to, "whole", [number])
        else:
            number = np.asarray(self.channel.receive(0, "whole")[0])
        return self.scattered(result) if number[1] else None, float(number[0])

    def shown(self, mesh: Mesh) -> Mesh | None:
        """The mesh of the whole grid in the first process, where meshes are shown."""
        return self.assembled(mesh, "shown") if self._shows else None

    def assembled(self, mesh: Mesh, kind: str) -> Mesh | None:
        """The mesh of the whole grid, in the first process; ``None`` in the others."""
        found = None
        if self.channel.number == 0:
            found = Mesh(np.empty(self.decomposition.grid.shape), np.empty(self.decomposition.grid.shape))
        for k, window in enumerate(self.patches):
            view = self.view(mesh, k) if k in self._places else None
            nodes = self.move(self._holders[k], 0, self.cut_from(view, window, window.part.owned), kind)
            if nodes is not None and found is not None:
                found.x[window.part.owned], found.y[window.part.owned] = nodes
        return found

    def scattered(self, whole: Mesh | None) -> Mesh:
        """The merged mesh of a mesh of the whole grid that the first process has."""
        found = {}
        for k, window in enumerate(self.patches):
            to = self._holders[k]
            if self.channel.number == 0 and whole is not None:
                part = window.restrict(whole)
                if to == 0:
                    found[k] = part
                else:
                    self.channel.send(to, "whole", [part.x, part.y])
            elif to == self.channel.number:
                x, y = self.channel.receive(0, "whole")
                found[k] = Mesh(x, y)
        return self.joined(found)

    def along_lines(
        self, axis: int, end: int, first: Callable[[int], Array], on: Callable[[int, Array], Array], kind: str
    ) -> dict[int, Array]:
        """The data that arrive over the interface at one ``end`` of every subdomain that is held here, along ``axis``.

        The subdomains at that end of the grid receive ``first`` of their number. Every other one receives what its
        neighbour there passes ``on``, by its number and what it has received.
        """
        found: dict[int, Array] = {}
        for before, k in chain(self.decomposition, axis, end):
            here = self.channel.number
            if before is None:
                if k in self._places:
                    found[k] = first(k)
                continue
            sender, to = self._holders[before], self._holders[k]
            passed = on(before, found[before]) if sender == here else None
            if sender != to and passed is not None:
                self.channel.send(to, kind, [passed])
            if to == here:
                found[k] = passed if passed is not None else np.asarray(self.channel.receive(sender, kind)[0])
        return found

    def deliver(self, sender: int, to: int, data: Callable[[], Sequence[Array]], kind: str) -> Sequence[Array] | None:
        """The data that one subdomain sends another, at the receiver."""
        return self.move(self._holders[sender], self._holders[to], data, kind)

    def line_sums(
        self, problem: Problem, windows: Sequence[SubdomainWindow], threads: int, *, local: bool = False
    ) -> LineSums:
        """The sums along lines that subdomains of these windows read; ``local``: they read those of sides alone."""
        del threads
        return HeldLineSums(problem, self, windows, local=local)

    def line_corrections(self, problem: Problem, threads: int) -> LineCorrections:
        """Corrections of all lines in the windows."""
        return LineCorrections(problem, threads, WindowSweep(problem, self))

    def _nodes(
        self, sender: int, to: int, state: Mesh | None, window: SubdomainWindow, place: Place, kind: str
    ) -> Sequence[Array] | None:
        """Nodes of one subdomain for another one."""
        return self.deliver(sender, to, self.cut_from(state, window, place), kind)

    def cut_from(self, state: Mesh | None, window: SubdomainWindow, place: Place) -> Callable[[], Sequence[Array]]:
        """A function that returns copies of the nodes of a window's ``state`` at a place of the grid."""

        def nodes() -> Sequence[Array]:
            assert state is not None
            local = moved(place, window.first)
            return [state.x[local].copy(), state.y[local].copy()]

        return nodes

    def move(self, source: int, to: int, data: Callable[[], Sequence[Array]], kind: str) -> Sequence[Array] | None:
        """The data from one part to another: at the receiver, else ``None``. ``data`` is called at the sender."""
        here = self.channel.number
        if source == here == to:
            return data()
        if source == here:
            self.channel.send(to, kind, data())
        return self.channel.receive(source, kind) if here == to else None

    def _gathered(self, states: Sequence[Mesh]) -> list[Mesh]:
        """The solutions of all subdomains, in the first process."""
        own, found = dict(zip(self.numbers, states, strict=True)), []
        for k in range(len(self.patches)):
            got = self.move(self._holders[k], 0, partial(_arrays, own, k), "whole")
            if got is not None:
                found.append(Mesh(*got))
        return found

    def _covered(self, k: int) -> Place:
        return self.patches[k].local(self.patches[k].covered)

    def _largest(self, number: Callable[[int], float]) -> float:
        return float(np.max(self.every({k: [number(k)] for k in self.numbers})))

    def _difference(self, one: Mesh, at: Place, other: Mesh, there: Place) -> float:
        pairs = ((one.x[at], other.x[there]), (one.y[at], other.y[there]))
        return float(np.max([largest_difference(a, b) for a, b in pairs]))


def _arrays(states: Mapping[int, Mesh], k: int) -> Sequence[Array]:
    return [states[k].x, states[k].y]


def holder(k: int, subdomains: int, processes: int) -> int:
    """The process that holds a subdomain: each holds as many consecutive ones as the others, or one more."""
    return k * processes // subdomains


def moved(place: tuple[slice, ...], first: tuple[int, ...]) -> Place:
    """A rectangle of the grid as one of a window that begins at the grid point ``first``."""
    xi, eta = (slice(cut.start - start, cut.stop - start) for cut, start in zip(place, first, strict=True))
    return xi, eta


def chain(decomposition: Decomposition, axis: int, end: int) -> list[tuple[int | None, int]]:
    """All subdomains from one ``end`` of an axis on, each with its neighbour nearer to that end, if there is one."""
    columns, rows = decomposition.subdomains
    counts, step = (columns, rows), -1 if end else 1
    along = range(counts[axis])[::step]
    found: list[tuple[int | None, int]] = []
    for k in along:
        for other in range(counts[1 - axis]):
            place = (k, other) if axis == 0 else (other, k)
            near = (k - step, other) if axis == 0 else (other, k - step)
            before = None if k == along[0] else decomposition.at(*near).number
            found.append((before, decomposition.at(*place).number))
    return found


# Line corrections of a merged mesh whose windows several processes hold.
#
# Every subdomain corrects its part of all grid lines. From its neighbours it gets the sums of the metric lengths
# beyond, how far the moving sides of the grid push the ends of each line, and afterwards the nodes beyond its
# interfaces.


class HeldLineSums:
    """The sums of a merged mesh in the windows that are held here; neighbours pass on the sums beyond them.

    ``windows`` reach one grid line beyond every interface.
    """

    def __init__(
        self, problem: Problem, holding: OnChannel, windows: Sequence[SubdomainWindow], *, local: bool = False
    ) -> None:
        self.points, self._holding, self._local = problem.grid.shape, holding, local
        self._windows, at = windows, interfaces(holding.decomposition)
        self._cuts, self._segments = dict[int, tuple[IntArray, IntArray]](), dict[int, Segments]()
        for k in holding.numbers:
            window, (xi, eta) = windows[k], windows[k].part.spans
            self._cuts[k] = cuts = line_cuts(at, (xi.first, eta.first), (xi.last, eta.last))
            # One row more, so that the last row of the subdomain is among those of the eta-lines.
            rows = np.append(cuts[0], xi.last + 1) if window.open[0, 1] else cuts[0]
            places = rows - window.first[0], cuts[1] - window.first[1]
            self._segments[k] = Segments(problem, window.shape, places, frame=Frame(physical=window.physical))
        self._beyond: dict[tuple[int, int], dict[int, Array]] = {}

    def read(self, mesh: Mesh) -> None:
        """Compute the sums of a merged mesh."""
        for k, here in self._segments.items():
            here.read(self._holding.restrict(self._windows[k], mesh))
        for axis in AXES:
            for end in ENDS:
                self._beyond[axis, end] = self._sums(axis, end)

    def beyond(self, window: SubdomainWindow, axis: int, end: int) -> Array:
        """The sums beyond one interface of a window."""
        return self._beyond[axis, end][window.part.number]

    def side_edges(self, window: SubdomainWindow, axis: int, end: int, along: int) -> Array:
        """The squared lengths of the two edges next to one interface, on a side."""
        span = window.part.spans[axis]
        local = (span.last if end else span.first) - window.first[axis]
        return self._segments[window.part.number].edges[1 - axis][along, local - 1 : local + 1]

    def _sums(self, axis: int, end: int) -> dict[int, Array]:
        def nothing(k: int) -> Array:
            return np.zeros(self._windows[k].shape[1 - axis])

        def passed(k: int, received: Array) -> Array:
            """With the edges up to the interface of the next subdomain."""
            cuts, pieces = self._cuts[k][axis], self._segments[k].along[axis]
            column, row = self._windows[k].part.place
            step = -1 if end else 1
            after = self._holding.decomposition.at(column + step * (axis == 0), row + step * (axis == 1)).spans[axis]
            edge = int(np.searchsorted(cuts, after.last if end else after.first))
            return added(received, pieces[edge : len(cuts) - 1][::-1] if end else pieces[:edge])

        if self._local:
            return {k: nothing(k) for k in self._holding.numbers}
        return self._holding.along_lines(axis, end, nothing, passed, "sums")


class WindowSweep:
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
            self._sweeps[k] = Sweep(problem.metric, problem.boundary, Rows.whole(window.shape), memory, frame)
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
        """The terms that the sides of the grid add to both ends of the lines of every window with an interface."""
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
