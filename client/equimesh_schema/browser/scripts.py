"""The modules of this folder as one script: pages in files, and widgets, cannot import one from another."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).parent
KERNEL = ("formula.js", "kernel.js")
"""What computes meshes; it knows no page."""
FIGURE = (*KERNEL, "work.js", "colours.js", "figure.js")
"""The figure with all that it needs."""
_COMMENT = re.compile(r"^ *//[^\n]*\n|^ */\*\*(?:[^*]|\*(?!/))*\*/\n|^ +", re.MULTILINE)
"""Comments, and the blanks in front of lines: no text of these modules goes over lines."""
_IMPORT = re.compile(r"^import (\{[^}]*\}) from \"\./(\w+)\.js\";\n", re.MULTILINE)
_LIST = re.compile(r"^export \{([^}]*)\};\n", re.MULTILINE)
_EXPORT = re.compile(r"^export ((?:async )?function\*?|const|class) (\w+)", re.MULTILINE)


@cache
def script(names: Sequence[str] = FIGURE) -> str:
    """The modules one after another without comments, each in a scope of its own; the exports of `name.js` are `$name`.

    A module may import from those before it.
    """
    parts = [_scoped(name.removesuffix(".js"), (FOLDER / name).read_text(encoding="utf-8")) for name in names]
    return "\n".join(parts)


def _scoped(name: str, text: str) -> str:
    exported = [each.strip() for names in _LIST.findall(text) for each in names.split(",")]
    exported += [each for _, each in _EXPORT.findall(text)]
    body = _IMPORT.sub(r"const \1 = $\2;\n", _LIST.sub("", _COMMENT.sub("", text)))
    body = _EXPORT.sub(r"\1 \2", body)
    return f"const ${name} = (() => {{\n{body}\nreturn {{ {', '.join(exported)} }};\n}})();\n"
