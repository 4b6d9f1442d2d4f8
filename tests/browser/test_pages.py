"""Browser: the service's pages in a real browser that can reach nothing but the service."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest

from equimesh_service import Settings, running
from programs import browser

BROWSER = browser()
pytestmark = pytest.mark.needs("chromium")
# No sandbox, as tests may run as root in a container; no name resolves, so that only the loopback address answers.
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    "--enable-logging=stderr",
    "--virtual-time-budget=20000",
    "--window-size=1200,2000",
]


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with running(Settings(data_dir=tmp_path_factory.mktemp("data"), port=0, workers=1, log_level="warning")) as url:
        yield url


@pytest.fixture
def rendered(tmp_path: Path) -> Callable[[str], str]:
    """The document of a page after its scripts have run, without a word of complaint in the console."""

    def page(address: str) -> str:
        command = [str(BROWSER), *FLAGS, f"--user-data-dir={tmp_path}", "--dump-dom", address]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
        assert complaints(done.stderr) == []
        return done.stdout

    return page


def complaints(log: str) -> list[str]:
    """What pages wrote to the console: violations of their policy, errors of their scripts."""
    return [line for line in log.splitlines() if ":CONSOLE" in line]


def test_a_violation_of_the_policy_is_seen(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    policy = '<meta http-equiv="Content-Security-Policy" content="script-src \'none\'">'
    page.write_text(f"{policy}<script>document.title = 'run'</script>")
    command = [str(BROWSER), *FLAGS, f"--user-data-dir={tmp_path}", "--dump-dom", page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert any("Content Security Policy" in line for line in complaints(done.stderr))


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
    assert "Failed to load" not in document
    assert "Unable to render" not in document


def test_the_front_page_leads_to_the_documentation(url: str, rendered: Callable[[str], str]) -> None:
    document = rendered(f"{url}/")
    assert 'href="docs"' in document
    assert "curl" in document


def test_the_playground_makes_a_mesh(url: str, rendered: Callable[[str], str]) -> None:
    document = rendered(f"{url}/#u=tanh(20*(x+y/2-0.75))&n=17")
    mesh = httpx.get(f"{url}/v1/meshes?label=playground").json()["items"][0]
    assert mesh["grid"] == {"n_xi": 17, "n_eta": 17}
    assert f"{mesh['quality']['q_eq']['max']:.3f}" in document
    assert '<img id="picture" alt="The mesh" src="blob:' in document
    assert '<section id="result">' in document


def test_the_playground_says_where_an_expression_is_wrong(url: str, tmp_path: Path) -> None:
    address = f"{url}/#u=sin(x*&n=17"
    command = [str(BROWSER), *FLAGS, f"--user-data-dir={tmp_path}", "--dump-dom", address]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    complaint = done.stdout.split('<pre id="complaint" role="alert">')[1].split("</pre>")[0].splitlines()
    assert complaint[0] == "sin(x*"
    assert complaint[1].strip() == "^"
    assert complaint[2] == "something is missing after '*'"
    assert '<section id="result" hidden="">' in done.stdout
