"""Rows of a text file from tables of integers."""

from typing import Any

import numpy as np
import numpy.typing as npt


def integer_rows(form: str, table: npt.NDArray[np.integer[Any]]) -> list[str]:
    """The rows of a ``table``, shape ``(k, c)``, each in a ``form`` with as many ``%d``.

    All rows are made by one operation: row by row takes twice as long.
    """
    if not len(table):
        return []
    return ("\n".join([form] * len(table)) % tuple(table.ravel().tolist())).split("\n")
