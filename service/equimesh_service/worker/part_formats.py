"""The formats of the files of meshes in parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from equimesh_cluster.part_files.formats import PARTED_FORMATS, PartedFormat, part_name


@dataclass(frozen=True, kw_only=True)
class PartFormat:
    """A format of a mesh in parts: the suffixes and media types of its head and of its parts, and who reads it.

    Without ``head_suffix`` there is no head.
    """

    name: str
    suffix: str
    media_type: str
    description: str
    head_suffix: str = ""
    head_media_type: str = ""

    def part_name(self, number: int) -> str:
        """The name of the file of a part, without its folder."""
        kind = PARTED_FORMATS.get(self.name)
        return f"part-{number:04d}{self.suffix}" if kind is None else part_name(number, kind)

    def path_of_part(self, mesh_id: str, number: int) -> str:
        """The path under which the head of a mesh looks for the file of a part."""
        return f"{mesh_id}/{self.part_name(number)}"

    def head_name(self, mesh_id: str) -> str:
        """The name of the file of the head."""
        return f"{mesh_id}{self.head_suffix}"


def _of(kind: PartedFormat) -> PartFormat:
    return PartFormat(
        name=kind.name,
        suffix=kind.part_suffix,
        media_type=kind.part_media_type,
        description=kind.readers,
        head_suffix=kind.suffix,
        head_media_type=kind.media_type,
    )


# The formats whose heads and parts are files; zarr is a folder.
HEADED = tuple(kind.name for kind in PARTED_FORMATS.values() if kind.part_suffix)
PART_FORMATS: Mapping[str, PartFormat] = {
    **{name: _of(PARTED_FORMATS[name]) for name in HEADED},
    "npz": PartFormat(
        name="npz",
        suffix=".npz",
        media_type="application/x-npz",
        description="NumPy: arrays x, y and u of the rows of a part; without a head",
    ),
}
# The format in which a mesh in parts is written, and from which other formats are made.
WRITTEN = "pvtu"
