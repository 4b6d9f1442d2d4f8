"""Routes of operations: health."""

from __future__ import annotations

import httpx
import pytest

from equimesh_service.problems.problem import KINDS

# What Chromium sends.
BROWSER = {"Accept": "text/html,application/xhtml+xml,application/xml;q=0.9,image/avif,image/webp,*/*;q=0.8"}


def test_health(http: httpx.Client) -> None:
    assert http.get("/livez").json() == {"status": "ok"}
    ready = http.get("/readyz")
    assert ready.status_code == 200
    assert set(ready.json()["checks"].values()) == {"ok"}


@pytest.mark.parametrize("name", ["invalid-input", "unauthorized"])
def test_a_problem_is_a_page_in_a_browser_and_json_elsewhere(http: httpx.Client, name: str) -> None:
    page, plain = http.get(f"/problems/{name}", headers=BROWSER), http.get(f"/problems/{name}")
    assert page.headers["content-type"].startswith("text/html")
    assert plain.json() == {
        "type": KINDS[name].type,
        "title": KINDS[name].title,
        "status": KINDS[name].status,
        "remedy": KINDS[name].remedy,
    }
    assert page.headers["vary"] == plain.headers["vary"] == "Accept"
    assert f"<h1>{KINDS[name].title}</h1>" in page.text
    assert str(KINDS[name].status) in page.text
    for other in KINDS:
        assert f'href="{other}"' in page.text
    assert KINDS[name].remedy.split("'")[0] in page.text


def test_an_unknown_problem_names_the_nearest(http: httpx.Client) -> None:
    answer = http.get("/problems/invalid-imput")
    assert answer.status_code == 404
    assert "did you mean 'invalid-input'?" in answer.json()["detail"]
