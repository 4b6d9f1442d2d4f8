"""Statements whose text is made once."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from sqlalchemy import Connection, Delete, Insert, Select, Update


@dataclass(frozen=True)
class Rows:
    """The rows that a statement has found, as the driver returns them, and the number of those that it has changed."""

    found: list[Any]
    rowcount: int

    def __iter__(self) -> Iterator[Any]:
        return iter(self.found)

    def all(self) -> list[Any]:
        """All rows: named tuples."""
        return self.found

    def first(self) -> Any:
        """The first row; None without rows."""
        return self.found[0] if self.found else None

    def scalars(self) -> list[Any]:
        """The first value of each row."""
        return [row[0] for row in self.found]

    def scalar(self) -> Any:
        """The first value of the first row; None without rows."""
        return self.found[0][0] if self.found else None


@dataclass(frozen=True)
class Prepared:
    """A statement of SQLAlchemy that the driver executes, with the text and the values that SQLAlchemy makes for it.

    To find a statement again that was compiled, and to look after a cursor, take SQLAlchemy longer than SQLite takes to
    execute it. Columns of an ``INSERT`` get no defaults but those of the database. There are a few texts of each
    statement: for the dialects, and for the names of the values.
    """

    statement: Insert | Delete | Update | Select[Any]
    _texts: dict[tuple[str, ...], _Text] = field(default_factory=dict)

    def execute(self, connection: Connection, *rows: Mapping[str, Any]) -> Rows:
        """Execute it once for each of ``rows`` of values, which have the same names in the same order."""
        names = (connection.dialect.name, *rows[0])
        text = self._texts.get(names)
        if text is None:
            text = self._texts[names] = _Text.of(self.statement, connection, rows[0])
        values: Any = [text.values(row) for row in rows]
        if not connection.in_transaction():
            connection.begin()
        cursor = connection.connection.cursor()
        try:
            if len(values) > 1:
                cursor.executemany(text.sql, values)
            else:
                cursor.execute(text.sql, values[0])
            columns: Any = cursor.description
            row_of = _row_of(tuple(column[0] for column in columns or ()))
            found = Rows([row_of(row) for row in cursor.fetchall()] if columns else [], cursor.rowcount)
        except Exception as error:
            cursor.close()  # SQLite keeps a connection until its last statement is gone
            # Raises it as SQLAlchemy does, which gives up a connection that is lost: no cursor can be closed after it.
            connection._handle_dbapi_exception(error, text.sql, values, None, None)
        cursor.close()
        return found


@cache
def _row_of(names: tuple[str, ...]) -> Callable[[Any], Any]:
    """What makes a named tuple of the values of a row."""
    made: Any = namedtuple("Row", names, rename=True)  # type: ignore[misc]
    make: Callable[[Any], Any] = made._make
    return make


@dataclass(frozen=True)
class _Text:
    """The text of a statement for a dialect, its values of all rows, and what the driver needs in place of others.

    ``order`` has the names in the order of their places; None where the text has names.
    """

    sql: str
    fixed: Mapping[str, Any]
    order: tuple[str, ...] | None
    makers: tuple[tuple[str, Callable[[Any], Any]], ...]

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
        needed = tuple((name, make) for name in row if (make := makers[name]) is not None)
        return cls(str(compiled), fixed, order, needed)

    def values(self, row: Mapping[str, Any]) -> tuple[Any, ...] | dict[str, Any]:
        """The values of a row for the driver."""
        made = {**row, **self.fixed}
        for name, make in self.makers:
            made[name] = make(made[name])
        return made if self.order is None else tuple([made[name] for name in self.order])
