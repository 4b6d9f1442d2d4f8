"""The place on the site of each file of the project, and the links of pages, rewritten to these places."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable
from pathlib import Path
from urllib.parse import unquote

ROOT = Path(__file__).parents[2]

# Pages that are not in docs/.
_NAMED = {
    "README.md": "project/readme.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "CHANGELOG.md": "project/changelog.md",
    "LICENSE": "project/license.md",
    "examples/README.md": "examples/index.md",
}
_FENCE = re.compile(r"^( *)(```+)[^\n]*\n.*?^\1\2 *$", re.MULTILINE | re.DOTALL)
# A link or an image in Markdown, and an address in HTML.
_LINK = re.compile(r"(\]\()([^)\s]+)(?=[)\s])|(\b(?:src|srcset|href)=\")([^\"]+)(?=\")")
_CODE = re.compile(r"(`+)[^`\n]*?\1")
_FOREIGN = re.compile(r"[a-z][a-z+.-]*:|#", re.IGNORECASE)


def place_of(path: str) -> str:
    """The name on the site of a file of the project, both relative and with forward slashes.

    A page of ``docs`` loses that prefix. Any other file becomes a page that shows its text.
    """
    if path in _NAMED:
        return _NAMED[path]
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    if path.startswith("examples/") and path.endswith((".py", ".ipynb")):
        return path.rpartition(".")[0] + ".md"
    return f"files/{path}.md"


def relinked(text: str, source: str, found: Callable[[str], None]) -> str:
    """The Markdown text of the page ``source`` with its links rewritten for the site.

    ``found`` is called with the path in the project of each file that is linked. Raises ValueError for a link to a file
    that does not exist.
    """
    kept = sorted([*_FENCE.finditer(text), *_CODE.finditer(text)], key=lambda match: match.start())
    parts, at = [], 0
    for match in kept:
        if match.start() >= at:
            parts += [_relinked(text[at : match.start()], source, found), match[0]]
            at = match.end()
    return "".join([*parts, _relinked(text[at:], source, found)])


def _relinked(text: str, source: str, found: Callable[[str], None]) -> str:
    def rewritten(match: re.Match[str]) -> str:
        opening, target = match[1] or match[3], match[2] or match[4]
        return match[0] if _FOREIGN.match(target) else opening + _moved(target, source, found)

    return _LINK.sub(rewritten, text)


def _moved(target: str, source: str, found: Callable[[str], None]) -> str:
    file, hash_mark, anchor = target.partition("#")
    path = posixpath.normpath(posixpath.join(posixpath.dirname(source), unquote(file)))
    if (ROOT / path).is_dir():
        path = posixpath.join(path, "index.md" if path.startswith("docs") else "README.md")
    if not (ROOT / path).is_file():
        raise ValueError(f"{source}: the link to {target} leads nowhere. Correct its path.")
    found(path)
    here = posixpath.dirname(place_of(source))
    return posixpath.relpath(place_of(path), here or ".") + hash_mark + anchor
