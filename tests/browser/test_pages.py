"""Browser: the service's pages in a real browser that can reach nothing but the service."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from browser.chromium import visit

pytestmark = pytest.mark.needs("chromium")


@pytest.fixture
def url(page_url: str) -> str:
    return page_url


@pytest.fixture
def rendered(tmp_path: Path) -> Callable[[str], str]:
    """The document of a page after its scripts have run, without a word of complaint in the console."""

    def page(address: str) -> str:
        found = visit(address, tmp_path)
        assert found.complaints == []
        return found.document

    return page


def test_a_violation_of_the_policy_is_seen(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    policy = '<meta http-equiv="Content-Security-Policy" content="script-src \'none\'">'
    page.write_text(f"{policy}<script>document.title = 'run'</script>")
    assert any("Content Security Policy" in line for line in visit(page.as_uri(), tmp_path).complaints)


def test_the_interactive_documentation_works_offline(url: str, rendered: Callable[[str], str]) -> None:
    document = rendered(f"{url}/docs#/meshes/createMesh")
    described = httpx.get(f"{url}/openapi.json").json()
    operations = [
        method
        for path in described["paths"].values()
        for method in path
        if method in {"get", "post", "delete", "head", "put"}
    ]
    assert document.count('class="opblock opblock-') == len(operations)
    assert described["info"]["title"] in document
    assert 'class="btn authorize unlocked"' in document  # keys can be given
    assert "is-open" in document  # and the operation of the address is unfolded, with its form
    assert 'value="wait=30"' in document  # so that its first request gives a mesh
    assert "Failed to load" not in document
    assert "Unable to render" not in document
