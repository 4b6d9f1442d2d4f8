"""The staged pages: those of `docs/` and of the project with links for the site, the generated reference, and lists."""

from __future__ import annotations

import ast
import posixpath
import re
import shutil
import tempfile
from collections.abc import Collection
from pathlib import Path

from generator.command_pages import command_pages
from generator.http_pages import http_pages
from generator.notebooks import markdown_of
from generator.places import ROOT, place_of, relinked
from generator.python_pages import python_pages

# Pages of the project outside docs/, in the order of the menu.
_PROJECT = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")
_KINDS = ("tutorials", "how-to", "reference", "background", "examples")
# The entries of the menu below the front page, with their captions.
_MENU = (
    ("", ("gallery.md", *(f"{kind}/index.md" for kind in _KINDS))),
    ("Project", ("project/readme.md", "project/changelog.md", "project/contributing.md", "design/index.md")),
)
# Titles in the menu, where that of the page says less.
_TITLES = {"project/readme.md": "README <{}>"}
_LANGUAGES = {".py": "python", ".json": "json", ".toml": "toml", ".yml": "yaml", ".yaml": "yaml", ".js": "js"}
_LISTED = re.compile(r"^\s*(?:- |\d+\. |\| |#+ )[^\n]*?\]\(([^)#\s]+\.(?:md|rst))\)", re.MULTILINE)
# What the list of the reference gets on the site, where these pages exist.
_GENERATED = """
## Made from the code

- [Python packages](packages/index.md): every public name, with its types and its docstring
- [operations of the HTTP interface](operations/index.md): every parameter, body, answer and schema
- [options of all commands](commands.md)
- [all settings of the service](variables.md)
"""
# The last line of the page of a notebook: its place on the server of deploy/notebook.yaml, and its file.
OPEN = """
[Run this notebook](http://localhost:8888/lab/tree/{0}) on your
[notebook server](../../how-to/deploy.md#with-compose), or {{download}}`take it along <{0}>`.
"""
# The page of the service for an address below /site that leads nowhere.
_NOWHERE = """---
orphan: true
---

# There is no such page

The address leads nowhere on this site. It may be that of an earlier release. Search for a word in the field at the
left, or begin at the [front page](index.md).
"""


def stage(folder: Path, *, only: Collection[str] | None = None) -> None:
    """Write all sources of the site into an empty folder, or ``only`` those of these names.

    Raises ValueError for a link that leads nowhere.
    """
    shutil.copytree(ROOT / "docs" / "images", folder / "images")
    pages = {"404.md": _NOWHERE, **_written_pages()}
    pages |= python_pages() | http_pages(_openapi()) | command_pages()
    pages["reference/index.md"] += _GENERATED
    if only is not None:
        pages = {name: pages[name] for name in only}
    for name, text in pages.items():
        if name.endswith("/index.md"):
            pages[name] = text + _toctree("", [page for page in _listed(name, text) if page in pages])
    for caption, names in _MENU:
        pages["index.md"] += _toctree(caption, [name for name in names if name in pages])
    for name, text in pages.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")


def _written_pages() -> dict[str, str]:
    """The pages that people wrote, by their names on the site, and those files that they link to."""
    paths = [*_PROJECT, "examples/README.md"]
    paths += [path.relative_to(ROOT).as_posix() for path in sorted((ROOT / "docs").rglob("*.md"))]
    pages: dict[str, str] = {}
    while paths:
        path = paths.pop()
        name = place_of(path)
        if name in pages or path.startswith("docs/images/"):
            continue
        is_notebook = path.endswith(".ipynb")
        text = markdown_of(ROOT / path) if is_notebook else (ROOT / path).read_text(encoding="utf-8")
        is_page = is_notebook or path.endswith(".md")
        pages[name] = relinked(text, path, paths.append) if is_page else _source_page(path, text)
        if is_notebook:
            pages[name] += OPEN.format(posixpath.basename(path))
            pages[name.removesuffix(".md") + ".ipynb"] = (ROOT / path).read_text(encoding="utf-8")
    return pages


def _source_page(path: str, text: str) -> str:
    """A page that shows a file of the project; an example begins with its docstring."""
    fence = "`" * max(3, *(len(run) + 1 for run in re.findall("`+", text) or [""]))
    language = _LANGUAGES.get(Path(path).suffix, "text")
    is_listed = posixpath.dirname(path) == "examples" and path.endswith(".py")
    opening = "" if is_listed else "---\norphan: true\n---\n\n"
    about = ast.get_docstring(ast.parse(text)) if language == "python" else None
    sentence = (about or "").split("\n\n")[0].replace("``", "`")
    return f"{opening}# {posixpath.basename(path)}\n\n{sentence}\n\n`{path}`:\n\n{fence}{language}\n{text}\n{fence}\n"


def _listed(name: str, text: str) -> list[str]:
    """The pages below an index page that its lists and tables link to, in their order, each once."""
    here = posixpath.dirname(name)
    found = (posixpath.normpath(posixpath.join(here, target)) for target in _LISTED.findall(text))
    return [page for page in dict.fromkeys(found) if page.startswith(f"{here}/") and page != name]


def _toctree(caption: str, names: list[str]) -> str:
    """The lines of a hidden list of pages, from which Sphinx makes its menu."""
    if not names:
        return ""
    heading = f":caption: {caption}\n" if caption else ""
    entries = "\n".join(_TITLES.get(name, "{}").format(f"/{name}") for name in names)
    return "\n```{toctree}\n:hidden:\n" + heading + "\n" + entries + "\n```\n"


def _openapi() -> dict[str, object]:
    from equimesh_service import Settings
    from equimesh_service.api.app import create_app

    with tempfile.TemporaryDirectory() as folder:
        return create_app(Settings(data_dir=Path(folder))).openapi()
