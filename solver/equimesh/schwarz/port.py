"""What the Schwarz iteration knows of its subdomains: one port for every family of transmission conditions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from equimesh.equations.mesh_equations import MeshEquations
from equimesh.equations.newton_solve import NewtonSolution
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, Pair
from equimesh.schwarz.window import SubdomainWindow

# Newton steps that a subdomain solve may take: it starts near its solution or has none near by.
MOST_LOCAL_STEPS = 25


@dataclass(frozen=True)
class Outcome:
    """A local solution, and whether classical data took the place of the asked condition."""

    solution: NewtonSolution
    classical: bool = False


class Slopes(Protocol):
    """How what subdomains receive changes with the merged mesh that they read."""

    def received(self, change: Pair) -> list[Array]:
        """The change of the right side of every subdomain's equations, when the merged mesh moves by ``change``."""
        ...


class Differentiable(Protocol):
    """Subdomains that know how their solutions depend on the merged mesh they read."""

    windows: list[SubdomainWindow]

    def begin(self, states: Sequence[Mesh], mesh: Mesh) -> None:
        """Read these states, and the mesh that they merge to."""
        ...

    def equations(self, k: int) -> MeshEquations:
        """The equations of a subdomain, with the data of the mesh that is read."""
        ...

    def slopes(self, states: Sequence[Mesh]) -> Slopes:
        """The derivative of the data, where the subdomains have the solutions ``states``."""
        ...


class Subdomains(Differentiable, Protocol):
    """All subdomains of a decomposition, with what they tell each other."""

    def begin(self, states: Sequence[Mesh], mesh: Mesh) -> None:
        """Read these states, and the mesh that they merge to, in the solves to come."""
        ...

    def solve(self, k: int) -> Outcome:
        """The solution of a subdomain."""
        ...

    def sent(self, k: int) -> int:
        """Numbers that a subdomain receives in one iteration."""
        ...
