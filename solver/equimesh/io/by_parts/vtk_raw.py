"""VTK XML files whose arrays follow the text as plain bytes, "raw appended data"."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias
from xml.sax.saxutils import quoteattr

import numpy as np
import numpy.typing as npt

from equimesh.io.vtu import NUMBERS, head

Blocks: TypeAlias = Callable[[], Iterator[npt.NDArray[Any]]]
"""Returns the values of an array block by block."""
# Bytes of the number before every array: how many bytes follow.
COUNT_BYTES = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class RawArray:
    """An array of a file: ``count`` numbers of type ``dtype``, in rows of ``components``."""

    name: str
    dtype: npt.DTypeLike
    count: int
    blocks: Blocks
    components: int = 1

    @property
    def bytes(self) -> int:
        """The bytes of its numbers."""
        return self.count * np.dtype(self.dtype).itemsize


Sections: TypeAlias = Mapping[str, Sequence[RawArray]]
"""The arrays of the sections of a piece, such as ``PointData``."""


def vtk_type(dtype: npt.DTypeLike) -> str:
    """VTK's name of a type of numbers."""
    kind = np.dtype(dtype)
    return f"{NUMBERS[kind.kind]}{8 * kind.itemsize}"


def write_raw(path: Path, kind: str, grid: str, piece: str, sections: Sections, extra: str = "") -> None:
    """Write a file of one piece. ``grid`` and ``piece`` are the attributes of these elements, ``extra`` goes between.

    Raises ``OSError`` where the file cannot be written, and ``ValueError`` for blocks that do not add up.
    """
    arrays = [array for section in sections.values() for array in section]
    text, offset = [f"{head(kind)}<{kind}{grid}>\n{extra}<Piece {piece}>\n"], 0
    for name, section in sections.items():
        text.append(f"<{name}{' GlobalIds=' + quoteattr(GLOBAL_IDS) if _has_ids(section) else ''}>\n")
        for array in section:
            text.append(
                f'<DataArray type="{vtk_type(array.dtype)}" Name={quoteattr(array.name)}'
                f' NumberOfComponents="{array.components}" format="appended" offset="{offset}"/>\n'
            )
            offset += COUNT_BYTES + array.bytes
        text.append(f"</{name}>\n")
    text.append(f'</Piece>\n</{kind}>\n<AppendedData encoding="raw">\n_')
    with path.open("wb") as file:
        file.write("".join(text).encode())
        for array in arrays:
            file.write(np.uint64(array.bytes).tobytes())
            written = 0
            for block in array.blocks():
                plain = np.ascontiguousarray(block, dtype=array.dtype)
                file.write(plain.reshape(-1).view(np.uint8).data)
                written += plain.nbytes
            if written != array.bytes:
                raise ValueError(f"{array.name} has {written} bytes, not {array.bytes}")
        file.write(b"\n</AppendedData>\n</VTKFile>\n")


# The array with the number of every node in the whole mesh: what two parts share has the same number.
GLOBAL_IDS = "GlobalNodeIds"


def _has_ids(section: Sequence[RawArray]) -> bool:
    return any(array.name == GLOBAL_IDS for array in section)


def head_text(kind: str, attributes: str, sections: Mapping[str, Iterable[str]], pieces: Iterable[str]) -> str:
    """The text of a head: a description of the arrays of each section, and the pieces."""
    lines = [f'{head(kind)}<{kind}{attributes} GhostLevel="0">']
    for name, arrays in sections.items():
        described = [*arrays]
        ids = f" GlobalIds={quoteattr(GLOBAL_IDS)}" if any(f'"{GLOBAL_IDS}"' in text for text in described) else ""
        lines += [f"<{name}{ids}>", *described, f"</{name}>"]
    return "\n".join([*lines, *pieces, f"</{kind}>", "</VTKFile>", ""])


def described(name: str, dtype: npt.DTypeLike, components: int = 1) -> str:
    """The description of an array in a head."""
    return f'<PDataArray type="{vtk_type(dtype)}" Name={quoteattr(name)} NumberOfComponents="{components}"/>'
