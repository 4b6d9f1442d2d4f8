"""Checks of the built pages: every link inside the site leads to a file, and to an anchor that its page has."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

# What the service replaces in the page for addresses that lead nowhere.
ROOT = "{{root}}"


class _Page(HTMLParser):
    """The anchors of a page, and its links."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        """Keep what the tag names and where it leads."""
        for name, value in attributes:
            if name in ("id", "name") and value:
                self.anchors.add(value)
            elif name in ("href", "src") and value is not None and tag != "use":
                self.links.append(value)


def broken_links(folder: Path) -> list[str]:
    """A sentence for each link of a built site that leads nowhere, or out of the folder."""
    pages = {path: _Page(path.read_text(encoding="utf-8")) for path in sorted(folder.rglob("*.html"))}
    faults = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link.removeprefix(ROOT))
            if parts.scheme or parts.netloc:
                continue
            file = (path.parent / unquote(parts.path)).resolve() if parts.path else path.resolve()
            if file == folder.resolve().parent:  # the service, one above the site
                continue
            if file.is_dir():
                file = file / "index.html"
            anchor = unquote(parts.fragment)
            found = pages.get(file)
            missing = not file.is_file() or not file.is_relative_to(folder.resolve())
            if missing or (anchor and found is not None and anchor not in found.anchors):
                faults.append(f"{path.relative_to(folder)}: the link to {link} leads nowhere.")
    return faults
