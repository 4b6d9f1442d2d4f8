"""Writing a mesh in parts: every part by the process that holds it, then the head."""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

from equimesh.errors import InputError
from equimesh.io.by_parts.contents import PartData, check_names
from equimesh.io.by_parts.formats import PartedFormat, parted_format
from equimesh.io.by_parts.layout import PartedGrid, part_folder, part_path, staged
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh_part import MeshPart


def write_part(
    path: str | os.PathLike[str], part: MeshPart, data: PartData | None = None, *, format: str | None = None
) -> Path:
    """Write what ``part`` holds, and return its file. ``path`` is that of the head, which is written at the end.

    The file is ``part-0003.vts`` in the folder ``mesh``, for part 3 of ``mesh.pvts``; that folder is made. ``format``
    is a name in :data:`~equimesh.io.PARTED_FORMATS`; without it the suffix of ``path`` decides. The file appears whole
    or not at all, and one that was there is replaced. Only some rows are copied at a time.

    This runs in the process that holds the part, which may be on another machine. The folder of ``path`` must be one
    that all these processes and the one that writes the head reach by the same name;
    :func:`~equimesh.io.by_parts.shared_folder.require_probe` finds out.

    Raises :class:`~equimesh.errors.InputError` for an unknown format, arrays that do not fit, and a folder that does
    not exist; ``OSError`` where a file cannot be written.
    """
    kind, head = parted_format(path, format), Path(path)
    contents = PartData() if data is None else data
    contents.check(part)
    require_folder(head)
    if kind.name == "zarr":
        from equimesh.io.by_parts import zarr_parts

        zarr_parts.write_part(head, part, contents)
        return head
    file = part_path(head, part.number, kind)
    file.parent.mkdir(exist_ok=True)
    with staged(file) as unfinished:
        _write_file(unfinished, kind, part, contents)
    return file


def write_head(
    path: str | os.PathLike[str],
    *,
    grid: Grid,
    cuts: Sequence[int],
    nodes: Sequence[str] = (),
    cells: Sequence[str] = (),
    format: str | None = None,
    parts_exist: bool = True,
) -> tuple[Path, ...]:
    """Write the head of a mesh whose parts are written, and return its files, the named one first.

    The parts begin at row 0 and at the rows ``cuts`` of ``grid``; ``nodes`` and ``cells`` are the names of their
    arrays, in the order in which they are listed. No part is opened. With ``parts_exist=False`` the files of the parts
    may still be missing, except for zarr, whose head is made of what the parts left.

    Raises :class:`~equimesh.errors.InputError` as :func:`write_part`, and where a part is not there; ``OSError`` where
    a file cannot be written.
    """
    kind, head = parted_format(path, format), Path(path)
    parted = PartedGrid.of(grid, cuts)
    check_names(nodes, cells)
    require_folder(head)
    if kind.name == "zarr":
        from equimesh.io.by_parts import zarr_parts

        zarr_parts.write_head(head, parted, nodes, cells)
        return (head,)
    if parts_exist:
        _require_parts(head, kind, parted)
    files = (head, head.with_suffix(kind.companion)) if kind.companion else (head,)
    for file in reversed(files):  # what the head refers to before the head
        with staged(file) as unfinished:
            _write_head_file(unfinished, file, kind, (parted, nodes, cells))
    return files


def remove_parted(path: str | os.PathLike[str], *, format: str | None = None) -> None:
    """Remove the head and all parts of an older mesh of this name, if there is one.

    Call it before the first part is written: otherwise the old head shows old and new parts together.
    """
    kind, head = parted_format(path, format), Path(path)
    if kind.name == "zarr":
        from equimesh.io.by_parts import zarr_parts

        zarr_parts.remove(head)
        return
    for file in (head, *([head.with_suffix(kind.companion)] if kind.companion else [])):
        file.unlink(missing_ok=True)
    folder = part_folder(head)
    for file in folder.glob(f"part-*{kind.part_suffix}"):
        file.unlink(missing_ok=True)
    if folder.is_dir() and not any(folder.iterdir()):
        shutil.rmtree(folder)


def _write_file(file: Path, kind: PartedFormat, part: MeshPart, data: PartData) -> None:
    match kind.name:
        case "pvts":
            from equimesh.io.by_parts import pvts

            pvts.write_part(file, part, data)
        case "pvtu":
            from equimesh.io.by_parts import pvtu

            pvtu.write_part(file, part, data)
        case "xdmf":
            from equimesh.io.by_parts import xdmf_parts

            xdmf_parts.write_part(file, part, data)
        case _:
            from equimesh.io.by_parts import vtkhdf

            vtkhdf.write_part(file, part, data)


def _write_head_file(
    file: Path, head: Path, kind: PartedFormat, described: tuple[PartedGrid, Sequence[str], Sequence[str]]
) -> None:
    """Write the file ``head`` under the name ``file``, which it has until it is finished."""
    match kind.name:
        case "pvts":
            from equimesh.io.by_parts import pvts

            file.write_text(pvts.head_of(head, *described), encoding="utf-8", newline="\n")
        case "pvtu":
            from equimesh.io.by_parts import pvtu

            file.write_text(pvtu.head_of(head, *described), encoding="utf-8", newline="\n")
        case "xdmf":
            from equimesh.io.by_parts import xdmf_parts

            if head.suffix == kind.companion:
                xdmf_parts.write_companion(file, head, *described)
            else:
                file.write_text(xdmf_parts.head_of(head, *described), encoding="utf-8", newline="\n")
        case _:
            from equimesh.io.by_parts import vtkhdf

            vtkhdf.write_head(file, head, *described)


def require_folder(head: Path) -> None:
    """Raise :class:`~equimesh.errors.InputError` where the folder of a head is not on this machine."""
    if not head.parent.is_dir():
        raise InputError(
            f"there is no folder {head.parent} on this machine: make it, or choose one that all workers reach",
            field="path",
        )


def _require_parts(head: Path, kind: PartedFormat, parted: PartedGrid) -> None:
    for number in range(parted.count):
        file = part_path(head, number, kind)
        if not file.is_file():
            raise InputError(
                f"part {number} of {parted.count} is not at {file}: write it first, in a folder that all workers and"
                " the caller reach",
                field="path",
            )
