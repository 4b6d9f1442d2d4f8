"""Files that appear whole or not at all."""

import os
import secrets
from pathlib import Path

from equimesh_client.errors import BadArgument


def write_atomically(path: str | Path, data: bytes) -> Path:
    """Write ``data`` to ``path`` under a temporary name and rename it; returns the path.

    Raises :class:`BadArgument` when the file cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(6)}.part")
    if path.is_dir():
        raise BadArgument(f"cannot write {path}: it is a folder")
    try:
        temporary.write_bytes(data)
        os.replace(temporary, path)
    except OSError as error:
        raise BadArgument(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)
    return path
