"""Lists of a service, page by page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from equimesh_client.wire import protocol
from equimesh_client.wire.protocol import Call

PAGE_RECORDS = 100
"""Records in one page of a list."""


class Pages:
    """The list of meshes, page by page: at most ``limit`` records in all; None for no limit.

    Lists of other things replace :meth:`call`.
    """

    def __init__(self, *, status: str | None, label: str | None, limit: int | None) -> None:
        self._status, self._label, self._left = status, label, limit
        self._cursor: str | None = None
        self.more = limit is None or limit > 0

    def next_call(self) -> Call:
        """The request for the next page."""
        return self.call(PAGE_RECORDS if self._left is None else min(self._left, PAGE_RECORDS), self._cursor)

    def call(self, size: int, cursor: str | None) -> Call:
        """The request for a page of ``size`` records after a ``cursor``."""
        return protocol.list_meshes(status=self._status, label=self._label, cursor=cursor, limit=size)

    def records(self, page: Mapping[str, Any]) -> list[dict[str, Any]]:
        """The records of a fetched page, up to the limit of the list."""
        records = list(page.get("items") or [])[: self._left]
        self._cursor = page.get("next_cursor")
        self._left = None if self._left is None else self._left - len(records)
        self.more = self._cursor is not None and (self._left is None or self._left > 0)
        return records


class SequencePages(Pages):
    """The list of sequences, page by page."""

    def __init__(self, *, limit: int | None) -> None:
        super().__init__(status=None, label=None, limit=limit)

    def call(self, size: int, cursor: str | None) -> Call:
        """The request for a page of ``size`` records after a ``cursor``."""
        return protocol.list_sequences(limit=size, cursor=cursor)
