"""Opens a picture with the viewer of the system."""

import os
import shutil
import sys
from pathlib import Path

# Programs that open a file with the viewer of the desktop, each with the words before the file.
DESKTOP_OPENERS = (("xdg-open",), ("gio", "open"), ("wslview",))


def open_picture(path: Path) -> bool:
    """Open a file with the system's viewer and do not wait for it; False where there is none, or no display."""
    words = _opener()
    if words is None:
        return False
    nothing = [(os.POSIX_SPAWN_OPEN, number, os.devnull, os.O_RDWR, 0) for number in (0, 1, 2)]
    try:
        os.posix_spawn(words[0], [*words, str(path.resolve())], os.environ, file_actions=nothing)
    except OSError:
        return False
    return True


def _opener() -> list[str] | None:
    """The program that opens a file, with its words."""
    if sys.platform == "darwin":
        return ["/usr/bin/open"]
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return None
    for program, *words in DESKTOP_OPENERS:
        found = shutil.which(program)
        if found is not None:
            return [found, *words]
    return None


def told(path: Path) -> str:
    """Open a picture, and return the sentence that says what was done."""
    if open_picture(path):
        return f"opened {path}"
    return f"no viewer or no display here: the picture is {path.resolve()}"
