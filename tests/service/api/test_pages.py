"""The pages need no network."""

from __future__ import annotations

import re

import httpx


def test_the_pages_load_nothing_from_elsewhere(http: httpx.Client) -> None:
    for page in ("/", "/docs"):
        answer = http.get(page)
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith("text/html")
        links = re.findall(r"""(?:src|href)\s*=\s*["']([^"']+)""", answer.text)
        assert links
        for link in links:
            assert "//" not in link, link
            if link == "site" or link.startswith("#"):  # the site is there when it was built
                continue
            assert http.get("/" + link.lstrip("/")).status_code == 200, link
    assert "SwaggerUIBundle" in http.get("/docs/assets/swagger-ui-bundle.js").text


def test_head_is_answered_as_get_on_every_page(http: httpx.Client) -> None:
    assets = ("/docs/assets/problem.css", "/workbench/main.js")
    for page in ("/", "/docs", *assets, "/openapi.json", "/problems/invalid-input", "/livez"):
        whole, head = http.get(page), http.head(page)
        assert (head.status_code, head.content) == (200, b""), page
        assert head.headers["content-type"] == whole.headers["content-type"], page
        assert int(head.headers["content-length"]) == len(whole.content), page
    assert http.head("/docs/assets/none").status_code == 404
