"""What the service writes is readable by its own user only."""

import os
from pathlib import Path

# Permissions that no new file gives: all of the group's and of the others'.
_WITHHELD = 0o077
# Permissions of a new data folder: all of its owner's, none of the others'.
_FOLDER_MODE = 0o700


def withhold_files() -> None:
    """Let every file that this process and its workers make from now on be readable by their user only.

    For commands. A service in a thread of another program leaves the files of that program alone.
    """
    os.umask(os.umask(_WITHHELD) | _WITHHELD)


def make_folder(path: Path) -> None:
    """Make a folder that only its owner may enter, unless it exists; an existing one keeps its permissions."""
    path.mkdir(mode=_FOLDER_MODE, parents=True, exist_ok=True)
