"""Meshes that follow a time-stepper, for asyncio: the twin of ``sequence``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy.typing as npt

from equimesh_client.aio.mesh import AsyncMesh
from equimesh_client.records.tables import Array
from equimesh_client.spec.domains import Domain
from equimesh_client.spec.monitors import Monitor
from equimesh_client.spec.request import DEADLINE, Wish
from equimesh_client.spec.schwarz import Schwarz
from equimesh_client.wire import flows, protocol, steps
from equimesh_client.wire.deadline import Deadline
from equimesh_client.wire.session import AsyncSession
from equimesh_client.wire.steps import Step


class AsyncSequence:
    """A mesh that moves with u. ``current`` is its last step, with the arrays of that mesh."""

    def __init__(self, session: AsyncSession, record: Mapping[str, Any], current: Step) -> None:
        self._session = session
        self.id = str(record["id"])
        self.current = current

    async def step(
        self,
        u: object,
        fields: Mapping[str, npt.ArrayLike] | None = None,
        *,
        parameters: Mapping[str, float] | None = None,
        t: float | None = None,
        deadline: float = DEADLINE,
    ) -> Step:
        """The next step, which is ``current`` from now on: a mesh for u, with u and the fields carried to its nodes.

        ``u`` is an array of values at the current nodes, shape ``(n_xi, n_eta)``; a callable ``u(x, y)``, asked there;
        or an expression, with ``parameters`` and the time ``t``. ``fields`` are arrays like u, by names.

        A call that was interrupted may be repeated: with the same arguments it is the same step. Raises
        :class:`Conflict` when another program has taken the step, :class:`MeshFailed` when it has no mesh (another
        one can then be taken in its place), and :class:`InvalidInput`.
        """
        call = steps.step_call(self.id, self.current, u, fields, parameters, t)
        self.current = await self._session.run(steps.advance(call, self._session.settings, Deadline.after(deadline)))
        return self.current

    @property
    def x(self) -> Array:
        """The x coordinates of the current nodes, shape ``(n_xi, n_eta)``."""
        return self.current.x

    @property
    def y(self) -> Array:
        """The y coordinates of the current nodes, shape ``(n_xi, n_eta)``."""
        return self.current.y

    async def mesh(self, *, deadline: float | None = None) -> AsyncMesh:
        """The current mesh, with its quality, its files and its pictures."""
        return AsyncMesh(self._session, await self._session.fetch(protocol.get_mesh(self.current.mesh_id), deadline))

    async def delete(self, *, deadline: float | None = None) -> None:
        """Delete the sequence and its meshes at the service."""
        settings = self._session.settings
        call = protocol.sequence(self.id, method="DELETE")
        await self._session.run(flows.delete(call, settings, settings.deadline(deadline)))


class AsyncSequences:
    """The sequences of a service: ``client.sequences``."""

    def __init__(self, session: AsyncSession) -> None:
        self._session = session

    async def start(
        self,
        u: object,
        n: int | tuple[int, int] = 64,
        *,
        monitor: Monitor | Mapping[str, Any] | None = None,
        domain: Domain | Mapping[str, Any] | None = None,
        a: float = 0.7,
        b: float = 0.05,
        schwarz: Schwarz | Mapping[str, Any] | None = None,
        boundary: str = "trace",
        mode: str = "discretization",
        allow_relaxed: bool = True,
        label: str | None = None,
        parameters: Mapping[str, float] | None = None,
        t: float | None = None,
        n_samples: int = 129,
        keep: int = 2,
        deadline: float = DEADLINE,
    ) -> AsyncSequence:
        """A sequence with its first mesh, adapted to ``u``; the arguments are those of :meth:`Client.generate`.

        The monitor is an :class:`ArcLength` or a :class:`Curvature`. The service keeps the last ``keep`` meshes.
        """
        wish = Wish(
            u=u,
            n=n,
            monitor=monitor,
            domain=domain,
            a=a,
            b=b,
            schwarz=schwarz,
            boundary=boundary,
            initial="nested",
            mode=mode,
            allow_relaxed=allow_relaxed,
            cells="quad",
            label=label,
            parameters=parameters,
            t=t,
            n_samples=n_samples,
            reuse=True,
        )
        flow = steps.begin(wish, keep, self._session.settings, Deadline.after(deadline))
        return AsyncSequence(self._session, *(await self._session.run(flow)))

    async def get(self, sequence_id: str, *, deadline: float = DEADLINE) -> AsyncSequence:
        """The sequence of that id at its current step, to go on with; raises :class:`NotFound`."""
        flow = steps.look(sequence_id, self._session.settings, Deadline.after(deadline))
        return AsyncSequence(self._session, *(await self._session.run(flow)))
