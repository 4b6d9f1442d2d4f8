"""Dask arrays of what stays on the workers: one chunk for each part, which is a view of its rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import dask.array as da
from dask.delayed import delayed
from dask.sizeof import sizeof
from distributed import Future

from equimesh.numerics.types import Array
from equimesh_cluster.parts.part_solution import PartSolution


@sizeof.register(PartSolution)  # type: ignore[untyped-decorator]
def bytes_of(part: PartSolution) -> int:
    """The memory of a part, which Dask has to know: it would move what seems small to where it is needed."""
    return part.mesh.x.nbytes + part.mesh.y.nbytes + part.reference.x.nbytes + part.reference.y.nbytes


def array_of(
    futures: Sequence[Future[PartSolution]],
    rows: Sequence[int],
    n_eta: int,
    values: Callable[[PartSolution], Array],
) -> Any:
    """The dask array whose chunk k is ``values`` of part k, of shape ``(rows[k], n_eta)``."""
    of_part = delayed(values, pure=False)
    chunks = [
        da.from_delayed(of_part(future), shape=(height, n_eta), dtype=float)
        for future, height in zip(futures, rows, strict=True)
    ]
    return da.concatenate(chunks, axis=0)


def own_x(part: PartSolution) -> Array:
    """x at the nodes of a part: a view, not a copy."""
    return part.mesh.x[part.mesh.own_rows]


def own_y(part: PartSolution) -> Array:
    """y at the nodes of a part: a view, not a copy."""
    return part.mesh.y[part.mesh.own_rows]


def own_u(part: PartSolution) -> Array:
    """u at the nodes of a part. Raises :class:`ValueError` where the monitor has no u."""
    field = part.problem.monitor.u
    if field is None:
        raise ValueError("the monitor has no u")
    return field.evaluate(own_x(part), own_y(part))[0]
