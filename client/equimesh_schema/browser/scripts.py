"""The modules of this folder as one script: pages in files, and widgets, cannot import one from another."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).parent
KERNEL = ("formula.js", "kernel.js")
"""What computes meshes; it knows no page."""
FIGURE = (*KERNEL, "colours.js", "figure.js")
"""The figure with all that it needs."""
_IMPORT = re.compile(r"^import [^;]*;\n", re.MULTILINE)
_NAMES = re.compile(r"^export \{[^}]*\};\n", re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?function|const|class)", re.MULTILINE)


@cache
def script(names: Sequence[str] = FIGURE) -> str:
    """The modules one after another, without what they import from and export to each other."""
    texts = [(FOLDER / name).read_text(encoding="utf-8") for name in names]
    return "\n".join(_EXPORT.sub("", _NAMES.sub("", _IMPORT.sub("", text))) for text in texts)
