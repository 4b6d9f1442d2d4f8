"""The subdomains of the finest mesh of a grid or of blocks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from equimesh.errors import InputError
from equimesh.least_error.cells import Region, regions_of
from equimesh.least_error.objective import Objective
from equimesh.least_error.restricted import Merged, RestrictedDescent
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, IntArray
from equimesh.schwarz.settings import Groups, Schwarz
from equimesh_schema.document import is_whole


@dataclass(frozen=True, kw_only=True)
class Subdomains:
    """Subdomains by their ``settings``."""

    settings: Schwarz

    def descend(
        self, objective: Objective, owner: IntArray, first: Array, exchanges: int, min_decrease: float, threads: int
    ) -> Iterator[tuple[Array, Merged]]:
        """The meshes after each exchange, from ``first`` on, with their objective.

        ``owner`` has the number of the subdomain of each cell, shape ``(cells,)``.
        """
        shared = self._restricted(objective, regions_of(objective.cells, owner, self.settings.overlap), threads)
        for merged, now in shared.descend(first, exchanges, self.settings.local_steps, min_decrease):
            yield shared.whole(merged), now

    def begin(self, weights: Sequence[float], start: Array, first: Array) -> None:
        """Called before a descent from ``first`` with these ``weights``, relative to the mesh ``start``."""

    def _restricted(self, objective: Objective, regions: Sequence[Region], threads: int) -> RestrictedDescent:
        return RestrictedDescent(objective, regions, threads)


def owners(settings: Schwarz, mesh: Mesh) -> IntArray:
    """The number of the subdomain that owns each cell of a mesh in blocks, shape ``(m,)``.

    Raises :class:`~equimesh.errors.InputError` for groups that do not have each block once; it names the block.
    """
    owner = np.empty(len(mesh.cells), dtype=np.int64)
    names = mesh.block_names
    groups = [[k] for k in range(len(names))] if settings.groups is None else list(_numbers(settings.groups, names))
    found: set[int] = set()
    for number, group in enumerate(groups):
        for block in group:
            if block in found:
                message = f"the block {names[block]} is in two groups: name each block once"
                raise InputError(message, field="schwarz.groups")
            found.add(block)
            owner[mesh.block_cells[block].ravel()] = number
    left = [name for k, name in enumerate(names) if k not in found]
    if left:
        raise InputError(f"the block {left[0]} is in no group: add it to one", field="schwarz.groups")
    return owner


def _numbers(groups: Groups, names: Sequence[str]) -> Iterator[list[int]]:
    """The numbers of the blocks of each group."""
    for k, group in enumerate(groups):
        yield [_number(block, names, f"schwarz.groups[{k}]") for block in group]


def _number(block: str | int, names: Sequence[str], field: str) -> int:
    """The number of a block that is given by its name or number."""
    if isinstance(block, str):
        if block in names:
            return names.index(block)
    elif is_whole(block) and 0 <= block < len(names):
        return int(block)
    known = ", ".join(names[:8]) + (" and others" if len(names) > 8 else "")
    raise InputError(f"there is no block {str(block)[:40]}: the blocks are {known}", field=field)
