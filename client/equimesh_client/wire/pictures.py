"""A picture of a mesh, drawn by the service."""

from dataclasses import dataclass, field
from pathlib import Path

from equimesh_client.wire.files import write_atomically


@dataclass(frozen=True, kw_only=True)
class Plot:
    """A picture: its bytes ``data`` and ``format`` (``svg`` or ``png``). Shows itself in a notebook."""

    data: bytes = field(repr=False)
    format: str

    def save(self, path: str | Path) -> Path:
        """Write the picture to ``path`` and return it. The suffix does not change the format."""
        return write_atomically(path, self.data)

    def _repr_svg_(self) -> str | None:
        return self.data.decode() if self.format == "svg" else None

    def _repr_png_(self) -> bytes | None:
        return self.data if self.format == "png" else None


def plot_format(path: str | Path | None, format: str | None) -> str:
    """``format``, or that of the suffix of ``path``, or svg."""
    if format is not None:
        return format
    suffix = Path(path).suffix.lower().lstrip(".") if path is not None else ""
    return suffix or "svg"
