"""The pages of the guide as HTML, from their Markdown, where nobody built the site.

Names are those of the built site, so that links to it lead to the same pages. A wheel holds the Markdown in ``pages``;
a service that runs from the folder of the project reads it there.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Mapping
from functools import cache, lru_cache
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

if TYPE_CHECKING:
    from markdown_it.token import Token

_PROJECT, _WHEEL = Path(__file__).parents[3], Path(__file__).parent / "pages"
ROOT = _PROJECT if (_PROJECT / "docs" / "index.md").is_file() else _WHEEL
# Pages that are not in docs/.
_NAMED = {
    "README.md": "project/readme.html",
    "CONTRIBUTING.md": "project/contributing.html",
    "CHANGELOG.md": "project/changelog.html",
    "examples/README.md": "examples/index.html",
}
_MENU = ("index", "gallery", "tutorials/index", "how-to/index", "reference/index", "background/index", "project/readme")
_TITLES = ("Guide", "Gallery", "Tutorials", "How to", "Reference", "Background", "README")
_FOREIGN = re.compile(r"[a-z][a-z+.-]*:|#", re.IGNORECASE)
_ADDRESS = re.compile(r"(\b(?:src|srcset|href)=\")([^\"]+)(?=\")")
_PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title} (equimesh)</title>
<link rel="stylesheet" href="{root}../docs/assets/problem.css">
<link rel="icon" href="{root}../workbench/icon.svg" type="image/svg+xml">
<nav><a href="{root}../">Back to the page</a> {menu}</nav>
<main>
{content}
</main>
<footer>These are the pages as they are written: without a search, and without the reference that is made from the code.
<code>deploy/site</code> in the folder of the project builds these, too.</footer>
</html>
"""


@cache
def guide_pages(root: Path = ROOT) -> Mapping[str, Path]:
    """The files of the guide by their names on the site; empty where an installation has none."""
    docs = root / "docs"
    if not (docs / "index.md").is_file():
        return {}
    found = {f"{path.relative_to(docs).with_suffix('').as_posix()}.html": path for path in docs.rglob("*.md")}
    found |= {path.relative_to(docs).as_posix(): path for path in (docs / "images").rglob("*") if path.is_file()}
    found |= {f"examples/{path.stem}.html": path for path in (root / "examples").glob("*.py")}
    return found | {name: root / path for path, name in _NAMED.items() if (root / path).is_file()}


def guide_page(name: str, pages: Mapping[str, Path]) -> str:
    """The page with this name, one of ``pages`` that is no picture, as HTML."""
    path = pages[name]
    return _rendered(name, path, path.stat().st_mtime_ns, tuple(pages.items()))


def guide_nowhere(depth: int) -> str:
    """The page for an address that leads nowhere, this many folders below the front page."""
    content = "<h1>There is no such page</h1>\n<p>The address leads nowhere in this guide.</p>"
    return _framed("There is no such page", content, "../" * depth)


@lru_cache(maxsize=64)
def _rendered(name: str, path: Path, _changed: int, pages: tuple[tuple[str, Path], ...]) -> str:
    from markdown_it import MarkdownIt

    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        fence = "`" * max(3, *(len(run) + 1 for run in re.findall("`+", text) or [""]))
        text = f"# {path.name}\n\n{fence}python\n{text}\n{fence}\n"
    markdown = MarkdownIt("commonmark", {"html": True}).enable("table")
    tokens = markdown.parse(text)
    links = _Links(name, path, {file.resolve(): page for page, file in pages})
    title = _prepare(tokens, links)
    content = markdown.renderer.render(tokens, markdown.options, {})
    return _framed(title or name, content, "../" * name.count("/"))


class _Links:
    """The links of a page, from paths in the project to names on the site."""

    def __init__(self, name: str, path: Path, names: Mapping[Path, str]) -> None:
        self._here, self._folder, self._names = posixpath.dirname(name), path.parent, names

    def moved(self, target: str) -> str | None:
        """The address of what a link means; None where that is not among the pages."""
        if _FOREIGN.match(target):
            return target
        file, hash_mark, anchor = target.partition("#")
        path = (self._folder / unquote(file)).resolve()
        found = next(
            (self._names[one] for one in (path, path / "index.md", path / "README.md") if one in self._names), ""
        )
        return posixpath.relpath(found, self._here or ".") + hash_mark + anchor if found else None


def _prepare(tokens: list[Token], links: _Links) -> str:
    """Move the links, name the headings, and move styles into classes; returns the text of the first heading."""
    title = ""
    for k, token in enumerate(tokens):
        if token.type == "heading_open":
            words = _text_of(tokens[k + 1])
            token.attrSet("id", re.sub(r"[^\w\- ]", "", words.lower()).replace(" ", "-"))
            title = title or words
        elif token.type in ("th_open", "td_open") and "style" in token.attrs:
            token.attrSet("class", str(token.attrs.pop("style")).partition(":")[2])  # the policy allows no styles here
        elif token.type == "html_block":
            token.content = _moved_html(token.content, links)
        _move_links(token.children or [], links)
    return title


def _move_links(children: list[Token], links: _Links) -> None:
    for token in children:
        if token.type == "html_inline":
            token.content = _moved_html(token.content, links)
        for name in ("href", "src"):
            if name in token.attrs:
                target = links.moved(str(token.attrs.pop(name)))
                if target is not None:  # a file that the guide does not hold: words without a link
                    token.attrSet(name, target)


def _moved_html(text: str, links: _Links) -> str:
    return _ADDRESS.sub(lambda found: found[1] + escape(links.moved(found[2]) or found[2]), text)


def _text_of(heading: Token) -> str:
    return "".join(token.content for token in heading.children or [] if token.type in ("text", "code_inline"))


def _framed(title: str, content: str, root: str) -> str:
    menu = " ".join(f'<a href="{root}{page}.html">{words}</a>' for page, words in zip(_MENU, _TITLES, strict=True))
    return _PAGE.format(title=escape(title), root=root, menu=menu, content=content)
