"""The workers of a cluster as a service knows them: which of them it may use, and why not the others."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from equimesh_service.engine.pool_report import PoolReport
from equimesh_service.engine.versions import describe_difference

# A worker without a sign of life for this time is taken for lost; it sends one every half second, or every few.
MAX_SILENT_SECONDS = 20.0
# The time between two visits of a worker.
VISIT_SECONDS = 20.0
# The most workers that a sentence names.
_MAX_NAMED = 3
_RUNNING = "running"  # the status of Dask


@dataclass(eq=False)
class Member:
    """A worker, by its address. ``refusal`` says why it is not used, "" while it starts."""

    address: str
    name: str
    report: PoolReport | None = None
    refusal: str = ""
    jobs: set[str] = field(default_factory=set)  # the keys of the jobs that it has
    seen: float = 0.0  # its last sign of life, by the clock of the scheduler
    heard: float = field(default_factory=time.monotonic)  # when that came, by the clock here
    visit_at: float = 0.0  # when to visit it next

    @property
    def slots(self) -> int:
        """How many jobs it may have at the same time."""
        return self.report.slots if self.report is not None and self.report.ready and not self.refusal else 0

    @property
    def free(self) -> int:
        """How many more jobs it may have now."""
        return self.slots - len(self.jobs)

    def note_visit(self, error: Exception | None) -> None:
        """Take over how a visit ended."""
        self.visit_at = time.monotonic() + VISIT_SECONDS
        if error is not None:
            self.report = None
        if isinstance(error, ModuleNotFoundError):
            self.refusal = f"it has no equimesh of this release ({error})"
        elif error is not None:
            self.refusal = f"it does not answer as expected ({type(error).__name__}: {error})"


class Members:
    """All workers of a cluster; ``here`` are the versions of the service, ``pool`` is the name of its pools."""

    def __init__(self, here: Mapping[str, str], pool: str) -> None:
        self._here, self._pool = here, pool
        self._members: dict[str, Member] = {}

    def __iter__(self) -> Iterator[Member]:
        return iter([*self._members.values()])

    def __len__(self) -> int:
        return len(self._members)

    def update(self, found: Mapping[str, Mapping[str, Any]]) -> list[Member]:
        """Take over what the scheduler knows of its workers, by address; returns the workers that are gone."""
        gone = [one for one in self if one.address not in found]
        for address, known in found.items():
            member = self._members.get(address)
            if member is not None and (_is_another(member, known, self._pool) or _is_silent(member, known)):
                gone.append(member)
                member = None
            if member is None:
                member = self._members[address] = Member(address, str(known["name"]))
            self._note(member, known)
        for member in gone:
            if self._members.get(member.address) is member:
                del self._members[member.address]
        return gone

    def _note(self, member: Member, known: Mapping[str, Any]) -> None:
        if known["last_seen"] != member.seen:
            member.seen, member.heard = known["last_seen"], time.monotonic()
        packed = known["metrics"].get(self._pool)
        if packed is None:
            if member.report is not None:  # its pool was closed
                member.report, member.visit_at = None, 0.0
            return
        member.report = PoolReport.of(packed)
        different = describe_difference(self._here, member.report.versions)
        member.refusal = f"it has {different}" if different else member.report.fault
        if not member.refusal and known["status"] != _RUNNING:
            member.refusal = f"it is {known['status']}"

    def clear(self) -> None:
        """Forget all workers."""
        self._members.clear()

    def find_free(self) -> Member | None:
        """The worker with the most free processes; None when no worker has any."""
        best = max(self, key=lambda one: one.free, default=None)
        return best if best is not None and best.free > 0 else None

    def find_unvisited(self) -> list[Member]:
        """The workers that are to be visited now."""
        now = time.monotonic()
        return [one for one in self if one.visit_at <= now]

    @property
    def slots(self) -> int:
        """How many jobs the workers may have at the same time."""
        return sum(one.slots for one in self)

    def refusals(self) -> list[str]:
        """A clause for each worker that is not used."""
        return [f"worker {one.name} is not used: {one.refusal}" for one in self if one.refusal]

    def describe(self) -> str:
        """The fault of the workers in a sentence; "" where there is none."""
        refusals = self.refusals()
        if refusals:
            more = len(refusals) - _MAX_NAMED
            return "; ".join(refusals[:_MAX_NAMED]) + (f"; and {more} more" if more > 0 else "")
        if self.slots:
            return ""
        return "workers are starting" if self._members else "there are no workers"


def _is_another(member: Member, known: Mapping[str, Any], pool: str) -> bool:
    """Whether another process has the address of a worker now."""
    packed = known["metrics"].get(pool)
    return member.report is not None and packed is not None and packed.get("identity") != member.report.identity


def _is_silent(member: Member, known: Mapping[str, Any]) -> bool:
    return known["last_seen"] == member.seen and time.monotonic() - member.heard > MAX_SILENT_SECONDS
