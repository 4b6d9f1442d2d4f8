"""The guide in its plain form: every page, with links that lead somewhere, and all of it in the wheel."""

from __future__ import annotations

import posixpath
import re
import tomllib
from pathlib import Path

import pytest

from equimesh_service.guide.plain import ROOT, guide_page, guide_pages

PAGES = guide_pages()
HTML = [name for name in PAGES if name.endswith(".html")]
# Addresses of the service itself, one level above the guide.
OUTSIDE = {"..", "../docs/assets/problem.css", "../workbench/icon.svg"}


def test_every_link_leads_to_a_page_or_a_picture_of_the_guide() -> None:
    for name in HTML:
        for target in re.findall(r'(?:href|src)="([^"]*)"', guide_page(name, PAGES)):
            if re.match(r"[a-z]+:|#", target):
                continue
            found = posixpath.normpath(posixpath.join(posixpath.dirname(name), target.partition("#")[0]))
            assert found in PAGES or found in OUTSIDE, (name, target)


def test_links_inside_of_pages_lead_to_their_headings() -> None:
    for name in HTML:
        for target, anchor in re.findall(r'href="([^":#]*)#([^"]+)"', guide_page(name, PAGES)):
            found = posixpath.normpath(posixpath.join(posixpath.dirname(name), target)) if target else name
            assert f'id="{anchor}"' in guide_page(found, PAGES), (name, target, anchor)


def test_pages_obey_the_policy_of_the_service() -> None:
    for name in HTML:
        page = guide_page(name, PAGES)
        assert "<script" not in page, name
        assert not re.search(r"<[^>]* style=", page), name


def test_a_page_that_is_changed_is_read_again(tmp_path: Path) -> None:
    (tmp_path / "docs" / "images").mkdir(parents=True)
    index = tmp_path / "docs" / "index.md"
    index.write_text("# One `code`\n\n[nowhere](none.md)\n\n| a |\n|--:|\n| 1 |\n")
    pages = guide_pages(tmp_path)
    page = guide_page("index.html", pages)
    assert '<h1 id="one-code">' in page
    assert "<a>nowhere</a>" in page
    assert '<td class="right">1</td>' in page
    index.write_text("# Another one, and longer\n")
    assert "Another one" in guide_page("index.html", pages)


@pytest.mark.skipif(not (ROOT / "pyproject.toml").is_file(), reason="runs from a wheel")
def test_a_wheel_holds_every_file_of_the_guide() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    included = settings["force-include"]
    for source, place in included.items():
        assert (ROOT / source).exists()
        assert place == f"equimesh_service/guide/pages/{source}"
    for path in PAGES.values():
        inside = path.relative_to(ROOT)
        assert any(str(part) in included for part in (inside, *inside.parents)), inside
