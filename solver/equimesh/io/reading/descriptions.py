"""Descriptions of blocks from files: their JSON, and OpenFOAM's blockMeshDict."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from equimesh.errors import InputError
from equimesh.io.reading.block_mesh_dict import read_block_mesh_dict
from equimesh.io.reading.refusals import refusing

# The members and entries of a JSON, at most; a description of a million points of curves has two million.
MAX_VALUES: Final = 3_000_000
# The name of the file, and of the format, of OpenFOAM.
BLOCK_MESH_DICT: Final = "blockMeshDict"


def _read_json(text: str) -> dict[str, Any]:
    """The object of a JSON text."""
    if text.count(",") + text.count(":") > MAX_VALUES:
        raise InputError(f"the JSON has more than {MAX_VALUES} values: no description needs them", field="file")
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"line {error.lineno}: {error.msg}: this is no JSON", field="file") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"the JSON cannot be read: {str(error)[:200]}", field="file") from error
    if not isinstance(document, dict):
        raise InputError("the JSON is no object: a description has vertices, blocks and sides", field="file")
    return document


# The reader of each format of descriptions.
DESCRIPTIONS: Final[dict[str, Callable[[str], dict[str, Any]]]] = {
    "json": _read_json,
    BLOCK_MESH_DICT: read_block_mesh_dict,
}


def description_format(path: str | os.PathLike[str]) -> str | None:
    """The format of a description by the name of its file, ``None`` for other files.

    A folder with ``system/blockMeshDict`` and without a mesh is none: name the file.
    """
    name = Path(path).name
    return "json" if name.lower().endswith(".json") else BLOCK_MESH_DICT if name.startswith(BLOCK_MESH_DICT) else None


def read_description(path: str | os.PathLike[str], format: str) -> dict[str, Any]:
    """The description in a file, as the object of its JSON; ``format`` is a name of ``DESCRIPTIONS``.

    Raises :class:`~equimesh.errors.InputError` for a file that cannot be read, with the line.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{Path(path).name} cannot be read: {error.strerror}", field="path") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{Path(path).name} is no text in UTF-8", field="path") from error
    with refusing(format):
        return DESCRIPTIONS[format](text)
