"""Meshes that follow a time-stepper, for both clients."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from typing import Any, Generic, TypeVar, Unpack

import numpy.typing as npt

from equimesh_client.mesh import AsyncMesh, M, Mesh
from equimesh_client.operation import Awaiting, Blocking, operation
from equimesh_client.records.resources import SequenceRecord
from equimesh_client.spec.fields import Field, Motion
from equimesh_client.spec.request import GenerateArguments, MeshOptions, complete_options
from equimesh_client.wire import protocol, steps
from equimesh_client.wire.protocol import SequencePages
from equimesh_client.wire.settings import DEADLINE_SECONDS, Deadline
from equimesh_client.wire.steps import SequenceState, SequenceStep
from equimesh_client.wire.transport import Session
from equimesh_schema.monitors import AnyMonitor as Monitor

S = TypeVar("S", bound="SequenceOperations[Any]")
"""The class of the sequences of a client."""


class SequenceOperations(SequenceState, Generic[M]):
    """What a sequence of either client does."""

    _mesh: type[M]

    def __init__(self, session: Session, record: Mapping[str, Any], current: SequenceStep) -> None:
        super().__init__(record, current)
        self._session = session

    @operation
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
        """The next step, which becomes ``current``: a mesh for u, with u and the fields at its nodes.

        ``u`` is an array of values at the current nodes, of the shape of :attr:`x`; a callable ``u(x, y)``, evaluated
        there; or an expression, with ``parameters`` and the time ``t``. ``fields`` are arrays like u, or
        :class:`Field`, by names. Both also take one value for each node in one row, fields of the libraries of the
        ``to_…()`` methods, and ``CellAverages``. With a ``monitor`` the settings change from this step on; its
        functions are like u, or ``{"field": name}``. Functions that it lacks are u, or stay those of the step before.
        ``motion`` is that of :class:`Motion`: ``smoothing`` in time, and ``max_move`` and ``outrun`` for fronts that
        leave their cells.

        An interrupted call may be repeated: the same arguments are the same step. Raises :class:`Conflict` when another
        program has taken the step, :class:`MeshFailed` when it has no mesh (another step may then replace it), and
        :class:`InvalidInput`.
        """
        given = steps.StepArguments(u=u, fields=fields, monitor=monitor, parameters=parameters, t=t, motion=motion)
        call = steps.step_call(self.id, self.current, given)
        self.current = await self._session.run(steps.advance(call, self._session.settings, Deadline.after(deadline)))
        return self.current

    @operation
    async def mesh(self, *, deadline: float | None = None) -> M:
        """The current mesh, with its quality, its files and its pictures."""
        return self._mesh(self._session, await self._session.fetch(protocol.get_mesh(self.current.mesh_id), deadline))

    def _repr_html_(self) -> str:
        """A picture and a table, for notebooks."""
        return self.current._repr_html_()

    @operation
    async def delete(self, *, deadline: float | None = None) -> None:
        """Delete the sequence and its meshes at the service."""
        await self._session.delete(protocol.sequence(self.id, method="DELETE"), deadline)


class SequencesOperations(Generic[S]):
    """What the sequences of either client do."""

    _sequence: type[S]

    def __init__(self, session: Session) -> None:
        self._session = session

    @operation
    async def start(
        self,
        u: object = None,
        n: int | tuple[int, int] = 64,
        *,
        keep: int = 2,
        deadline: float = DEADLINE_SECONDS,
        **options: Unpack[MeshOptions],
    ) -> S:
        """A sequence with its first mesh, adapted to ``u``; the arguments are those of :meth:`Client.generate`.

        The service keeps the last ``keep`` meshes. A domain of blocks has numbers of cells of its own: leave ``n`` out.
        """
        arguments = GenerateArguments(u=u, n=n, options=complete_options(options, type(self).start))
        flow = steps.begin(arguments, keep, self._session.settings, Deadline.after(deadline))
        return self._sequence(self._session, *(await self._session.run(flow)))

    @operation
    async def get(self, sequence_id: str, *, deadline: float = DEADLINE_SECONDS) -> S:
        """The sequence of that id at its current step, from which it continues; raises :class:`NotFound`."""
        flow = steps.look(sequence_id, self._session.settings, Deadline.after(deadline))
        return self._sequence(self._session, *(await self._session.run(flow)))

    @operation
    async def list(self, *, limit: int | None = None, deadline: float | None = None) -> AsyncIterator[SequenceRecord]:
        """The sequences, newest first, at most ``limit``; fetched page by page, each within ``deadline``."""
        pages = SequencePages(limit=limit)
        while pages.more:
            for record in pages.records(await self._session.fetch(pages.next_call(), deadline)):
                yield SequenceRecord.from_json(record)


class Sequence(Blocking, SequenceOperations[Mesh]):
    """A mesh that moves with u. ``current`` is its last step, with the arrays of that mesh."""

    _mesh = Mesh


class Sequences(Blocking, SequencesOperations[Sequence]):
    """The sequences of a service: ``client.sequences``."""

    _sequence = Sequence


class AsyncSequence(Awaiting, SequenceOperations[AsyncMesh]):
    """A mesh that moves with u, for asyncio. ``current`` is its last step, with the arrays of that mesh."""

    _mesh = AsyncMesh


class AsyncSequences(Awaiting, SequencesOperations[AsyncSequence]):
    """The sequences of a service, for asyncio: ``client.sequences``."""

    _sequence = AsyncSequence
