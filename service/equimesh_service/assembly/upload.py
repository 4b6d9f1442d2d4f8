"""Files that come with a request, as their bytes."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from functools import cached_property

# The most bytes of samples that the service reads itself, also when they are unpacked.
MAX_LIGHT_BYTES = 256 * 1024


@dataclass(frozen=True)
class Upload:
    """An uploaded file: its bytes, the name whose suffix gives its format, and the name of u among its columns."""

    data: bytes
    filename: str
    column: str | None = None

    @cached_property
    def is_light(self) -> bool:
        """Whether the file is read faster here than in a worker."""
        return is_light(self.data, self.filename)


def is_light(data: bytes, filename: str) -> bool:
    """Whether a file is read in about a millisecond: npz or npy, and small, also when it is unpacked."""
    if filename.lower().endswith(".npy"):
        return len(data) <= MAX_LIGHT_BYTES
    if not filename.lower().endswith(".npz") or len(data) > MAX_LIGHT_BYTES:
        return False
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return sum(entry.file_size for entry in archive.infolist()) <= MAX_LIGHT_BYTES
    except (zipfile.BadZipFile, ValueError, NotImplementedError):
        return False  # a worker reports what is wrong
