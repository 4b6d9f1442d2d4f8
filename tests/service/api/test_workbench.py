"""The workbench comes file by file from a table, with types, ETags and a policy."""

from __future__ import annotations

import re

import httpx
import pytest

from equimesh_service.api.pages import workbench_files

POLICY = "Content-Security-Policy"


def test_the_page_runs_and_loads_only_what_the_service_sends(http: httpx.Client) -> None:
    page = http.get("/")
    policy = dict(rule.split(" ", 1) for rule in page.headers[POLICY].split("; "))
    assert policy["default-src"] == "'none'"
    assert policy["script-src"] == policy["style-src"] == policy["connect-src"] == "'self'"
    assert not re.search(r"<style|style=|<script(?![^>]* src=)|\son\w+=", page.text)


def test_every_file_is_served_with_its_type(http: httpx.Client) -> None:
    names = {*workbench_files()} - {"index.html"}
    assert {"main.js", "workbench.css", "drawing/webgl.js", "panels/function.js", "icon.svg"} <= names
    for name in names:
        answer = http.get(f"/workbench/{name}")
        assert answer.status_code == 200, name
        assert answer.content == workbench_files()[name].content
        assert answer.headers["content-type"].split(";")[0] == workbench_files()[name].media_type


def test_every_import_of_a_script_leads_to_a_file() -> None:
    files = workbench_files()
    scripts = {name: file.content.decode() for name, file in files.items() if name.endswith(".js")}
    imports = [(name, found) for name, text in scripts.items() for found in re.findall(r' from "(.+?)";', text)]
    assert len(imports) > len(scripts) / 2
    for name, found in imports:
        parts = name.split("/")[:-1]
        for part in found.split("/"):
            parts = parts[:-1] if part == ".." else parts if part == "." else [*parts, part]
        assert "/".join(parts) in files, (name, found)


def test_an_unchanged_file_is_not_sent_again(http: httpx.Client) -> None:
    first = http.get("/workbench/main.js")
    assert first.headers["cache-control"] == "no-cache"
    again = http.get("/workbench/main.js", headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert http.get("/workbench/main.js", headers={"If-None-Match": '"another"'}).status_code == 200


@pytest.mark.parametrize("path", ["none.js", "../settings.py", "%2e%2e/settings.py", "index.html", "drawing", ""])
def test_nothing_else_is_served(http: httpx.Client, path: str) -> None:
    assert http.get(f"/workbench/{path}").status_code == 404
