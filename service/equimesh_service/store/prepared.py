"""Statements whose text is made once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import Connection, CursorResult, Delete, Insert, Select, Update


@dataclass(frozen=True)
class Prepared:
    """A statement of SQLAlchemy that the driver executes, with the text and the values that SQLAlchemy makes for it.

    To find a statement again that was compiled takes SQLAlchemy longer than SQLite takes to execute it. Rows come as
    the driver returns them, and columns of an ``INSERT`` get no defaults but those of the database. There are a few
    texts of each statement: for the dialects, and for the names of the values.
    """

    statement: Insert | Delete | Update | Select[Any]
    _texts: dict[tuple[str, ...], _Text] = field(default_factory=dict)

    def execute(self, connection: Connection, *rows: Mapping[str, Any]) -> CursorResult[Any]:
        """Execute it once for each of ``rows`` of values, which have the same names in the same order."""
        names = (connection.dialect.name, *rows[0])
        text = self._texts.get(names)
        if text is None:
            text = self._texts[names] = _Text.of(self.statement, connection, rows[0])
        values = [text.values(row) for row in rows]
        return connection.exec_driver_sql(text.sql, values if len(values) > 1 else values[0])


@dataclass(frozen=True)
class _Text:
    """The text of a statement for a dialect, its values of all rows, and what each other value becomes.

    ``order`` has the names in the order of their places; None where the text has names.
    """

    sql: str
    fixed: Mapping[str, Any]
    order: tuple[str, ...] | None
    makers: Mapping[str, Callable[[Any], Any] | None]

    @classmethod
    def of(
        cls, statement: Insert | Delete | Update | Select[Any], connection: Connection, row: Mapping[str, Any]
    ) -> _Text:
        dialect = connection.dialect
        compiled: Any = statement.compile(dialect=dialect, column_keys=[*row])
        named = compiled.bind_names.items()
        makers = {name: one.type.dialect_impl(dialect).bind_processor(dialect) for one, name in named}
        given = compiled.params
        fixed = {name: make(given[name]) if make else given[name] for name, make in makers.items() if name not in row}
        order = tuple(compiled.positiontup) if compiled.positional else None
        return cls(str(compiled), fixed, order, {name: makers[name] for name in row})

    def values(self, row: Mapping[str, Any]) -> tuple[Any, ...] | dict[str, Any]:
        """The values of a row for the driver."""
        made = {name: row[name] if make is None else make(row[name]) for name, make in self.makers.items()}
        made.update(self.fixed)
        return made if self.order is None else tuple([made[name] for name in self.order])
