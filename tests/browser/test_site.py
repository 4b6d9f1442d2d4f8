"""A part of the site, built with every warning an error, under a service and in a real browser that is offline.

The part has a page of each kind: the front page, a tutorial, formulas, and generated reference. ``--everything`` builds
and checks the whole.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, ConsoleMessage, Page

from equimesh_service.api import pages as site_routes

ROOT = Path(__file__).parents[2]
# Pages of every kind; links to others lead nowhere in this part of the site.
PART = (
    "index.md",
    "404.md",
    "gallery.md",
    "tutorials/index.md",
    "tutorials/first-mesh.md",
    "background/index.md",
    "background/theory-schwarz.md",
    "reference/index.md",
    "reference/expressions.md",
    "reference/packages/index.md",
    "reference/packages/equimesh.testing.rst",
    "reference/operations/index.md",
    "reference/operations/checks.md",
    "project/readme.md",
)
BUILD = """
import sys
from pathlib import Path
from generator.command import install, run_sphinx
from generator.staging import stage

source, built, output = map(Path, sys.argv[1:4])
source.mkdir()
stage(source, only=sys.argv[4:])
left_out = "suppress_warnings=myst.xref_missing"
assert run_sphinx(source, built, "html", "-D", left_out) == 0
install(built, output)
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The part of the site, as files."""
    folder = tmp_path_factory.mktemp("built")
    places = [str(folder / name) for name in ("source", "html", "site")]
    command = [sys.executable, "-c", BUILD, *places, *PART]
    done = subprocess.run(command, cwd=ROOT / "docs", capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "site"


@pytest.fixture(scope="module")
def url(built: Path, page_url: str) -> Iterator[str]:
    """The address of the site in the service of all pages."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(site_routes, "FOLDER", built)
        yield f"{page_url}/site/"


SCREENS = {"laptop, light": ("light", 1366, 768), "phone, dark": ("dark", 390, 844)}


@pytest.fixture
def page(chromium: Browser, request: pytest.FixtureRequest, url: str) -> Iterator[Page]:
    """A page of a browser that reaches the service alone, and fails on a complaint in the console."""
    scheme, width, height = SCREENS[getattr(request, "param", "laptop, light")]
    context = chromium.new_context(color_scheme=scheme, viewport={"width": width, "height": height})
    context.set_default_timeout(300_000)
    opened = context.new_page()
    complaints: list[str] = []

    def hear(message: ConsoleMessage) -> None:
        if message.type in ("error", "warning"):
            complaints.append(message.text)

    opened.on("console", hear)
    opened.on("pageerror", lambda error: complaints.append(str(error)))
    asked: set[str] = set()
    opened.on("request", lambda request: asked.add(urlsplit(request.url).netloc))
    opened.goto(url)
    yield opened
    assert asked == {urlsplit(url).netloc}
    context.close()
    assert complaints == []


def test_pages_have_no_inline_script_or_style(built: Path) -> None:
    for path in built.rglob("*.html"):
        text = path.read_text()
        assert "<style" not in text, path
        assert ' style="' not in text, path
        assert " onclick=" not in text, path
        assert all(script.lstrip().startswith(("src=", "data-")) for script in text.split("<script")[1:]), path


@pytest.mark.needs("chromium")
@pytest.mark.parametrize("page", SCREENS, indirect=True)
def test_pages_are_readable_for_everyone(page: Page, url: str, everything: bool) -> None:
    axe, width = Axe(), page.viewport_size and page.viewport_size["width"]
    of_each_kind = ("", "reference/operations/checks.html", "tutorials/first-mesh.html",
                    "reference/packages/equimesh.testing.html", "background/theory-schwarz.html")  # fmt: skip
    for name in of_each_kind if everything or width == SCREENS["laptop, light"][1] else of_each_kind[:1]:
        page.goto(url + name)
        found = axe.run(page)
        assert found.violations_count == 0, name + "\n" + found.generate_report()
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), name


@pytest.mark.needs("chromium")
def test_the_search_works_offline_and_leads_to_the_page(page: Page, url: str) -> None:
    page.goto(url + "search.html?q=hypot")
    result = page.locator("#search-results li a", has_text="Expressions").first
    result.wait_for()
    result.click()
    page.wait_for_url("**/reference/expressions.html*")
    assert page.locator("h1").inner_text().startswith("Expressions")


@pytest.mark.needs("chromium")
def test_formulas_are_drawn_without_a_script(page: Page, url: str) -> None:
    page.goto(url + "background/theory-schwarz.html")
    boxes = [formula.bounding_box() for formula in page.locator(".formula math").all()]
    assert len(boxes) >= 2
    assert all(box is not None and box["height"] > 12 for box in boxes)


@pytest.mark.needs("chromium")
def test_links_lead_from_the_front_page_to_a_name_and_its_signature(page: Page, url: str) -> None:
    page.goto(url)
    page.get_by_role("link", name="All of the reference").click()
    page.locator("article").get_by_role("link", name="Python packages").click()
    page.locator("article").get_by_role("link", name="equimesh.testing").click()
    entry = page.locator('[id="equimesh.testing.check_domain"]')
    assert "domain: Domain" in " ".join(entry.inner_text().split())


FIGURE = ".mesh-figure"
SETTLED = f"{FIGURE}[data-state=settled]"


def gain(page: Page) -> float:
    """The gain that the figure of a page shows, once it moves no more."""
    page.locator(SETTLED).wait_for()
    return float(page.locator(FIGURE).get_attribute("data-gain") or "nan")


@pytest.mark.needs("chromium")
def test_the_picture_of_the_front_page_moves_under_the_hand(page: Page) -> None:
    first = gain(page)
    assert first > 10
    assert f"{first:.3g} times smaller" in page.locator(".mesh-figure-answer").inner_text()
    slider, text = page.get_by_role("slider", name="k"), page.get_by_label("u(x, y) =")
    slider.press("ArrowRight")
    assert gain(page) > first  # of a steeper front
    text.fill("exp(-q*(x² + y²))")
    fault = page.get_by_role("alert")
    assert "'q' is not a known name" in fault.inner_text()
    fault.get_by_role("button", name="Make q a slider").click()
    assert 1 < gain(page) < first
    assert page.get_by_role("slider", name="q").is_visible()
    page.get_by_role("button", name="arc length").click()
    page.locator("figcaption", has_text="arc length, error").wait_for()


@pytest.mark.needs("chromium")
def test_pictures_of_the_gallery_move_where_the_page_knows_their_domain(page: Page, url: str) -> None:
    page.goto(f"{url}gallery.html")
    buttons = page.get_by_role("button", name="Move it: ")
    assert buttons.count() == 12
    page.get_by_role("button", name="Move it: Bow shock").click()
    assert gain(page) > 10
    assert buttons.count() == 11


@pytest.mark.needs("chromium")
@pytest.mark.parametrize("scripts", [True, False])
def test_the_front_page_works_from_a_folder_and_without_scripts(chromium: Browser, built: Path, scripts: bool) -> None:
    opened = chromium.new_page(java_script_enabled=scripts)
    opened.goto((built / "index.html").as_uri())
    if scripts:
        assert gain(opened) > 10
    assert opened.locator("article img").first.is_visible() is not scripts
    opened.close()


@pytest.mark.needs("chromium")
def test_an_address_that_leads_nowhere_leads_back(chromium: Browser, url: str) -> None:
    opened = chromium.new_page()
    answer = opened.goto(f"{url}how-to/of/an/earlier/release.html")
    assert answer.status == 404
    opened.get_by_role("link", name="front page").click()
    assert opened.url == f"{url}index.html"
    opened.close()


@pytest.mark.everything
def test_the_whole_site_is_built_without_a_warning_and_every_link_in_it_leads_somewhere(tmp_path: Path) -> None:
    command = [ROOT / "deploy/site", "--output", tmp_path / "site"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stdout + done.stderr
    pages = {path.relative_to(tmp_path / "site").as_posix() for path in (tmp_path / "site").rglob("*.html")}
    sources = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    assert {f"{name.removesuffix('.md')}.html" for name in sources} <= pages
    assert {"project/changelog.html", "examples/01_first_mesh.html", "reference/packages/equimesh_client.html"} <= pages
