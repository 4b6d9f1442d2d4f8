"""Settings of the Schwarz iteration between blocks: which of them are one subdomain, and what these exchange."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from equimesh.errors import InputError
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import IntArray

Groups: TypeAlias = Sequence[Sequence[str | int]]

MAX_OVERLAP = 64
"""Layers of cells of the overlap, at most: with more, every subdomain does most of the work of the whole mesh."""
MAX_STEPS = 1000
"""Steps of a subdomain in one exchange, and exchanges, at most."""


@dataclass(frozen=True, kw_only=True)
class BlockSchwarz:
    """Settings of the Schwarz iteration between the blocks of a domain, for the mesh of least error.

    Coarse meshes are solved whole. On the finest mesh every subdomain takes ``local_steps`` of descent with the others
    held; then all moves are merged, and subdomains exchange them. A subdomain is a block, or a group of blocks:
    ``groups`` has names or numbers of blocks, each block once. It also has ``overlap`` layers of cells of its
    neighbours. ``max_exchanges`` is by default as many as take the steps of a solve of the whole mesh.

    Raises :class:`~equimesh.errors.InputError` with a field such as ``schwarz.overlap``.
    """

    overlap: int = 4
    local_steps: int = 8
    max_exchanges: int | None = None
    groups: Groups | None = None

    def __post_init__(self) -> None:
        limits = {"overlap": MAX_OVERLAP, "local_steps": MAX_STEPS, "max_exchanges": MAX_STEPS}
        for name, most in limits.items():
            value = getattr(self, name)
            if name == "max_exchanges" and value is None:
                continue
            if not (isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= most):
                message = f"{name} = {str(value)[:20]}: a whole number from 1 to {most}"
                raise InputError(message, field=f"schwarz.{name}")
        if self.groups is not None:
            object.__setattr__(self, "groups", _tuples(self.groups))

    def exchanges(self, steps: int) -> int:
        """How many exchanges there are at most, where the descent of the whole mesh would take so many ``steps``."""
        return self.max_exchanges or max(1, math.ceil(steps / self.local_steps))

    def owners(self, mesh: QuadMesh) -> IntArray:
        """The number of the subdomain that owns each cell of a mesh in blocks, shape ``(m,)``.

        Raises :class:`~equimesh.errors.InputError` for groups that do not have each block once; it names the block.
        """
        owner = np.empty(len(mesh.cells), dtype=np.int64)
        names = mesh.block_names
        groups = [[k] for k in range(len(names))] if self.groups is None else list(self._numbers(names))
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

    def _numbers(self, names: Sequence[str]) -> Iterator[list[int]]:
        """The numbers of the blocks of each group."""
        for k, group in enumerate(self.groups or ()):
            yield [_number(block, names, f"schwarz.groups[{k}]") for block in group]


def _tuples(groups: object) -> tuple[tuple[str | int, ...], ...]:
    """The groups as tuples."""
    if not (
        isinstance(groups, list | tuple) and groups and all(isinstance(one, list | tuple) and one for one in groups)
    ):
        raise InputError(
            "groups: give a list of groups, each a list of names or numbers of blocks: [['inlet', 'top'], ['outlet']]",
            field="schwarz.groups",
        )
    return tuple(tuple(group) for group in groups)


def _number(block: str | int, names: Sequence[str], field: str) -> int:
    """The number of a block that is given by its name or number."""
    if isinstance(block, str):
        if block in names:
            return names.index(block)
    elif isinstance(block, int) and not isinstance(block, bool) and 0 <= block < len(names):
        return block
    known = ", ".join(names[:8]) + (" and others" if len(names) > 8 else "")
    raise InputError(f"there is no block {str(block)[:40]}: the blocks are {known}", field=field)
