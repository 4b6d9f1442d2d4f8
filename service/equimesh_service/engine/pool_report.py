"""The state of the pool of a worker, as it travels from the worker to the services of the cluster."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class PoolReport:
    """The state of a pool: how many jobs it takes at the same time, and whether it takes any now.

    ``identity`` names the process of the worker; ``fault`` says why it cannot be used, "" while it starts.
    """

    identity: str
    slots: int
    versions: Mapping[str, str]
    ready: bool
    fault: str = ""

    def packed(self) -> dict[str, Any]:
        """The report as a record of plain values."""
        return asdict(self)

    @classmethod
    def of(cls, packed: Mapping[str, Any]) -> PoolReport:
        """The report in a record; unknown values, of other releases, are left out."""
        known = {name: packed[name] for name in cls.__dataclass_fields__ if name in packed}
        return cls(**known)
