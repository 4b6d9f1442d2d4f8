"""Meshes that follow a time-stepper, for asyncio: the twin of ``equimesh_client.blocking.sequence``."""

from collections.abc import AsyncIterator, Mapping
from typing import Any, Unpack

import numpy.typing as npt

from equimesh_client.aio.mesh import AsyncMesh
from equimesh_client.records.sequences import SequenceRecord
from equimesh_client.spec.fields import Field
from equimesh_client.spec.mesh import MeshOptions, complete_options
from equimesh_client.spec.motion import Motion
from equimesh_client.spec.request import GenerateArguments
from equimesh_client.wire import protocol, steps
from equimesh_client.wire.deadline import DEADLINE_SECONDS, Deadline
from equimesh_client.wire.pages import SequencePages
from equimesh_client.wire.session import AsyncSession
from equimesh_client.wire.steps import SequenceState, SequenceStep
from equimesh_schema.monitors import AnyMonitor as Monitor


class AsyncSequence(SequenceState):
    """A mesh that moves with u. ``current`` is its last step, with the arrays of that mesh."""

    def __init__(self, session: AsyncSession, record: Mapping[str, Any], current: SequenceStep) -> None:
        super().__init__(record, current)
        self._session = session

    async def step(
        self,
        u: object = None,
        fields: Mapping[str, npt.ArrayLike | Field] | None = None,
        *,
        monitor: Monitor | Mapping[str, Any] | None = None,
        parameters: Mapping[str, float] | None = None,
        t: float | None = None,
        deadline: float = DEADLINE_SECONDS,
        **motion: Unpack[Motion],
    ) -> SequenceStep:
        """The next step, which becomes ``current``. See :meth:`Sequence.step`."""
        given = steps.StepArguments(u=u, fields=fields, monitor=monitor, parameters=parameters, t=t, motion=motion)
        call = steps.step_call(self.id, self.current, given)
        self.current = await self._session.run(steps.advance(call, self._session.settings, Deadline.after(deadline)))
        return self.current

    async def mesh(self, *, deadline: float | None = None) -> AsyncMesh:
        """The current mesh, with its quality, its files and its pictures."""
        return AsyncMesh(self._session, await self._session.fetch(protocol.get_mesh(self.current.mesh_id), deadline))

    async def delete(self, *, deadline: float | None = None) -> None:
        """Delete the sequence and its meshes at the service."""
        await self._session.delete(protocol.sequence(self.id, method="DELETE"), deadline)


class AsyncSequences:
    """The sequences of a service: ``client.sequences``."""

    def __init__(self, session: AsyncSession) -> None:
        self._session = session

    async def start(
        self,
        u: object = None,
        n: int | tuple[int, int] = 64,
        *,
        keep: int = 2,
        deadline: float = DEADLINE_SECONDS,
        **options: Unpack[MeshOptions],
    ) -> AsyncSequence:
        """A sequence with its first mesh, adapted to ``u``. See :meth:`Sequences.start`."""
        arguments = GenerateArguments(u=u, n=n, options=complete_options(options, self.start))
        flow = steps.begin(arguments, keep, self._session.settings, Deadline.after(deadline))
        return AsyncSequence(self._session, *(await self._session.run(flow)))

    async def get(self, sequence_id: str, *, deadline: float = DEADLINE_SECONDS) -> AsyncSequence:
        """The sequence of that id at its current step, from which it continues; raises :class:`NotFound`."""
        flow = steps.look(sequence_id, self._session.settings, Deadline.after(deadline))
        return AsyncSequence(self._session, *(await self._session.run(flow)))

    async def list(self, *, limit: int | None = None, deadline: float | None = None) -> AsyncIterator[SequenceRecord]:
        """The sequences, newest first, at most ``limit``. See :meth:`Sequences.list`."""
        pages = SequencePages(limit=limit)
        while pages.more:
            for record in pages.records(await self._session.fetch(pages.next_call(), deadline)):
                yield SequenceRecord.from_json(record)
