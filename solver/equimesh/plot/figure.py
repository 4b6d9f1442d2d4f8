"""Figures: their style and files, and the lines of meshes in them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, IntArray
from equimesh.schwarz.decomposition import Decomposition
from equimesh_coupling.display import drawing, pieces_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure


Series: TypeAlias = Mapping[str, tuple[Array, Array]]

METADATA: dict[str, dict[str, str | None]] = {
    ".png": {"Software": "equimesh"},
    ".svg": {"Creator": "equimesh", "Date": None},
}
"""The suffixes of pictures, and their metadata: nothing that changes from one run to the next."""
RESOLUTION = 150
"""Dots per inch of a PNG."""
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#333333")
"""Colours of lines, of Okabe and Ito: they stay apart for colour-blind eyes."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
LINE_STYLES = ("-", "--", ":")
MAX_ZERO = 1e-250
"""A logarithmic axis shows smaller values as zero."""


@contextmanager
def figure_file(path: str | Path, width: float, height: float) -> Iterator[Figure]:
    """A figure of ``width`` x ``height`` inches that is written to ``path`` when the block ends.

    Raises :class:`~equimesh.errors.InputError` for another suffix than those of ``METADATA``, and
    ``ImportError`` without matplotlib.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in METADATA:
        raise InputError(f"{path.name}: pictures are written as {' or '.join(METADATA)}", field="path")
    with drawing(width, height) as figure:
        figure.set_layout_engine("constrained")
        yield figure
        figure.savefig(path, format=suffix[1:], dpi=RESOLUTION, metadata=METADATA[suffix])


def semilog(axes: Axes, series: Series) -> None:
    """Draw labelled ``(iteration, value)`` lines on a logarithmic axis.

    Zeros are marked at the bottom of the axes and infinite values at the top; nan leaves a gap.
    """
    values = np.concatenate([value for _, value in series.values()] or [np.zeros(0)])
    positive = values[np.isfinite(values) & (values > MAX_ZERO)]
    low, high = np.log10([positive.min(), min(positive.max(), 1 / MAX_ZERO)]) if positive.size else (-16.0, 0.0)
    margin = max(0.2 + 0.04 * (high - low), 0.6 - 0.5 * (high - low))
    axes.set_yscale("log")
    axes.set_ylim(10 ** (low - margin), 10 ** (high + margin))
    for number, (label, (at, value)) in enumerate(series.items()):
        colour = COLOURS[number % len(COLOURS)]
        axes.plot(
            at,
            np.where(np.isfinite(value) & (value > MAX_ZERO), value, np.nan),
            LINE_STYLES[number // len(COLOURS) % len(LINE_STYLES)],
            color=colour,
            marker=MARKERS[number % len(MARKERS)],
            markersize=5,
            markerfacecolor="white",
            markevery=max(1, value.size // 25),
            linewidth=1.4,
            label=label,
        )
        for height, end, where in ((0.02, "v", abs(value) <= MAX_ZERO), (0.98, "^", np.isinf(value))):
            heights = np.full(int(where.sum()), height)
            axes.plot(at[where], heights, end, color=colour, transform=axes.get_xaxis_transform())
    for label, end, some in (
        ("zero", "v", (abs(values) <= MAX_ZERO).any()),
        ("infinite", "^", np.isinf(values).any()),
    ):
        if some:
            axes.plot([], [], end, color="#888888", label=label)
    axes.grid(True)
    if len(axes.get_legend_handles_labels()[0]) > 1:
        axes.legend(loc="upper right", fontsize=9)  # "best" searches, and warns on a busy machine


def iteration_axis(axes: Axes, at: Array) -> None:
    """An axis of iteration numbers: whole ones, with room around a single one."""
    from matplotlib.ticker import MaxNLocator

    axes.set_xlabel("iteration")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    low, high = (float(at.min()), float(at.max())) if at.size else (0.0, 0.0)
    margin = max(0.03 * (high - low), 0.2)
    axes.set_xlim(low - margin, high + margin)


# The lines of a mesh in a picture: all, or every k-th, and the subdomain of each edge.

SHARED_OWNER = -1
"""The owner of edges that several subdomains hold."""


@dataclass(frozen=True, eq=False)
class MeshLines:
    """The mesh lines at indices ``columns`` along xi and ``rows`` along eta, and the nodes where they cross.

    ``x``, ``y`` have shape ``(len(columns), len(rows))``; ``step`` is 1 when all lines are chosen.
    """

    x: Array
    y: Array
    columns: IntArray
    rows: IntArray
    step: int

    @classmethod
    def of(cls, mesh: Mesh, *, most: int, decomposition: Decomposition | None = None) -> MeshLines:
        """About ``most`` lines in a direction; the sides, and the ends of subdomains, always among them."""
        step = max(1, math.ceil((max(mesh.x.shape) - 1) / most))
        spans = [(part.columns, part.rows) for part in decomposition.parts] if decomposition else []
        columns, rows = (
            np.unique([*range(0, n, step), n - 1, *(end for span in spans for end in (span[k][0], span[k][-1]))])
            for k, n in enumerate(mesh.x.shape)
        )
        window = np.ix_(columns, rows)
        return cls(mesh.x[window], mesh.y[window], columns, rows, step)

    @property
    def remark(self) -> str:
        """The remark of a title on lines that are left out; empty when there are none."""
        return remark_on(self.step)

    def owners(self, of_cell: IntArray, decomposition: Decomposition | None) -> tuple[IntArray, IntArray]:
        """The subdomain of every drawn edge along xi and along eta, ``SHARED_OWNER`` where several hold its ends.

        Without a decomposition, the subdomain that a neighbouring cell was taken from.
        """
        i, j = self.columns, self.rows
        along_xi = of_cell[np.ix_(i[:-1], np.minimum(j, of_cell.shape[1] - 1))]
        along_eta = of_cell[np.ix_(np.minimum(i, of_cell.shape[0] - 1), j[:-1])]
        if decomposition is None:
            return along_xi, along_eta
        holders = np.zeros_like(along_xi), np.zeros_like(along_eta)
        for part in decomposition.parts:
            column, row = np.isin(i, part.columns), np.isin(j, part.rows)
            for held, owner, count in (
                (np.outer(column[:-1] & column[1:], row), along_xi, holders[0]),
                (np.outer(column, row[:-1] & row[1:]), along_eta, holders[1]),
            ):
                owner[held] = part.number
                count[held] += 1
        return np.where(holders[0] > 1, SHARED_OWNER, along_xi), np.where(holders[1] > 1, SHARED_OWNER, along_eta)

    def polylines(self, along_xi: IntArray, along_eta: IntArray, owner: int) -> list[Array]:
        """The longest runs of edges that belong to ``owner``, each of shape ``(nodes, 2)``."""
        return _runs(self.x, self.y, along_xi == owner) + _runs(self.x.T, self.y.T, (along_eta == owner).T)


def remark_on(step: int) -> str:
    """What a title says where one line in ``step`` is drawn; empty when there are no others."""
    return f"\n(one line in {step} drawn)" if step > 1 else ""


def _runs(x: Array, y: Array, mine: npt.NDArray[np.bool_]) -> list[Array]:
    """Runs of marked edges along the first index."""
    runs = []
    for line in range(x.shape[1]):
        edges = np.concatenate([[False], mine[:, line], [False]])
        changes = np.flatnonzero(edges[1:] != edges[:-1])
        for start, stop in changes.reshape(-1, 2):
            runs.append(np.column_stack([x[start : stop + 1, line], y[start : stop + 1, line]]))
    return runs


# The lines of a mesh of blocks in a picture, and cells with colours for any mesh.


def step_of(mesh: Mesh, most: int) -> int:
    """Every how many lines one is drawn, so that no block has more than about ``most`` lines in a direction."""
    return max((math.ceil((max(block.shape) - 1) / most) for block in mesh.blocks), default=1)


def block_lines(mesh: Mesh, block: int, step: int) -> list[Array]:
    """Every ``step``-th line of a block in both directions, its four edges among them; shape ``(nodes, 2)`` each."""
    numbers = mesh.blocks[block]
    rows, columns = (np.unique([*range(0, n, step), n - 1]) for n in numbers.shape)
    return [mesh.points[numbers[i]] for i in rows] + [mesh.points[numbers[:, j]] for j in columns]


def outlines(mesh: Mesh) -> list[Array]:
    """The four edges of every block, shape ``(nodes, 2)`` each."""
    edges = [(block[0], block[-1], block[:, 0], block[:, -1]) for block in mesh.blocks]
    return [mesh.points[line] for four in edges for line in four]


def all_edges(mesh: Mesh) -> list[Array]:
    """The edges of all cells, for a mesh whose blocks are not known; one closed line for each cell."""
    return [*mesh.points[np.column_stack([mesh.cells, mesh.cells[:, 0]])]]


def drawn_lines(mesh: Mesh, most: int) -> tuple[list[Array], int]:
    """The lines of all blocks, about ``most`` in a direction of each, and every how many lines one is drawn."""
    if not mesh.blocks:
        return all_edges(mesh), 1
    step = step_of(mesh, most)
    return [line for k in range(len(mesh.blocks)) for line in block_lines(mesh, k, step)], step


def colour_cells(axes: Axes, mesh: Mesh, values: Array, **style: Any) -> ScalarMappable:
    """Draw every cell with the colour of its value, an array of the ``cell_shape`` of the mesh, perhaps masked.

    ``style`` is that of matplotlib's ``pcolormesh``, with a ``norm``.
    """
    drawn = [piece.draw(axes, **style) for piece in pieces_of(mesh, values)]
    return drawn[0]


def owners_of_blocks(mesh: Mesh, of_cell: IntArray) -> list[int] | None:
    """The subdomain of every block; ``None`` where a block has cells of several."""
    owners = []
    for cells in mesh.block_cells:
        found = np.unique(of_cell[cells])
        if len(found) > 1:
            return None
        owners.append(int(found[0]))
    return owners
