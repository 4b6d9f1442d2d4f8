"""What is copied from the page runs: in a shell, in Python, on the command line, and as a link."""

from __future__ import annotations

import ast
import json
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx
import pytest
from playwright.sync_api import Page, expect

import equimesh_client
from browser.workbench.panels import panel
from equimesh_schema.monitors import MONITORS

pytestmark = pytest.mark.needs("chromium")
ODD = 'it\'s "mine" $HOME `id` \\n %s !! é 𝑢'
SPECS: dict[str, dict[str, Any]] = {
    "usual": {
        "monitor": {"u": {"expression": "-tanh(k*(x-y))", "parameters": {"k": 9}}},
        "grid": {"n_xi": 13, "n_eta": 9},
    },
    "odd": {
        "monitor": {
            "kind": "weight",
            "rho": {"expression": "1 + a*exp(-20*y)", "parameters": {"a": 30}},
            "u": {"expression": "-x*t", "t": 2},
            "smoothing": 0.05,
        },
        "domain": {"kind": "annulus_sector", "center": [1, 0]},
        "grid": {"n_xi": 17, "n_eta": 13},
        "schwarz": {
            "transmission": {"kind": "nonlinear_robin", "p": 2},
            "tolerance": None,
            "max_iterations": 3,
            "line_correction": 2,
            "fallback": False,
        },
        "boundary": "equidistributed_1d",
        "cells": "triangle",
        "label": ODD,
    },
    "members": {
        "monitor": {
            "kind": "intersection",
            "monitors": [
                {"u": {"expression": "tanh(9*(x-k))", "parameters": {"k": 1}}, "a": 0.5},
                {"kind": "weight", "rho": {"expression": "1 + k*exp(-20*y)", "parameters": {"k": 20}}},
            ],
        },
        "domain": {
            "kind": "quadrilateral",
            "bottom": {"x": "3*t", "y": "h*sin(pi*t)**8", "parameters": {"h": 0.15}},
            "right": {"points": [[3, 0], [3, 1]]},
            "top": {"points": [[0, 1], [3, 1]]},
            "left": {"points": [[0, 0], [0, 1]]},
        },
        "grid": {"n_xi": 25, "n_eta": 9},
        "mode": "tight",
    },
}
# On the command line there are no intersections.
MISSING = {("members", "command")}
# Words of a stranger's link that a shell or Python would run if they were not quoted.
SHELL = "9; touch owned #"
PYTHON = "breakpoint()"
HOSTILE: list[dict[str, Any]] = [
    {"monitor": {"kind": SHELL, "u": SHELL, "for": SHELL}, "grid": {"n_xi": SHELL, "n_eta": SHELL}},
    {"monitor": {"u": {"expression": "x*t", "t": SHELL}}, "grid": {"n_xi": SHELL, "n_eta": 9}, "boundary": SHELL},
    {"monitor": {"u": "x"}, "target": {"error": SHELL, "norm": SHELL}, "domain": {"x": [0, SHELL], "y": [0, 1]}},
    {
        "monitor": {"u": "x"},
        "domain": {"kind": "annulus_sector", "radii": [1, SHELL]},
        "schwarz": {"subdomains": [SHELL, 2]},
    },
    {"monitor": {"u": "x", f"a={PYTHON}, b": 1}, "grid": {"n_xi": PYTHON, "n_eta": PYTHON}},
    {"monitor": {"kind": "intersection", "monitors": [{"u": "x", f"a={PYTHON}, b": 1}], f"c={PYTHON}, d": 1}},
    {"monitor": {"u": "x"}, "schwarz": {f"a={PYTHON}, b": 1}, "target": {f"a={PYTHON}, b": 1}},
    {"monitor": {"u": "x"}, "domain": {"kind": "rectangle", f"x={PYTHON}, y": [0, 1]}},
]
WRITTEN = """
async (spec) => {
  const [{ commandOf }, { clientProgram, solverProgram }] = await Promise.all(
    ["command_line", "python"].map((name) => import(`./workbench/copying/${name}.js`)),
  );
  const options = { url: "http://localhost/", format: { suffix: ".vtu" }, hasKey: false };
  return [commandOf(spec, options).text ?? "", clientProgram(spec, options), solverProgram(spec, options)];
}
"""
CLIPBOARD = ["clipboard-read", "clipboard-write"]


def copied(page: Page, kind: str) -> str:
    box = panel(page, "copy")
    box.get_by_label("Copy as").select_option(kind)
    page.evaluate("navigator.clipboard.writeText('')")
    box.locator("button.primary").click()
    while not (text := str(page.evaluate("navigator.clipboard.readText()"))):  # its button tells so for a moment only
        page.wait_for_timeout(20)
    return text


def run(text: str, kind: str, folder: Path) -> None:
    """Run what was copied, as a visitor would, in an empty folder."""
    words = [shutil.which("sh") or "sh", "-c", text] if kind in ("curl", "command") else [sys.executable, "-c", text]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        words, cwd=folder, env={**os.environ, "PATH": path}, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, f"{text}\n{done.stderr}"


@pytest.mark.parametrize(
    "name", [name if name == "usual" else pytest.param(name, marks=pytest.mark.everything) for name in SPECS]
)
def test_what_is_copied_gives_the_mesh(name: str, visit: Callable[..., Page], page_url: str, tmp_path: Path) -> None:
    spec = SPECS[name]
    page = visit(f"/#spec={quote(json.dumps(spec))}", permissions=CLIPBOARD)
    assert json.loads(copied(page, "spec")) == spec
    answer = httpx.post(f"{page_url}/v1/meshes?format=npz", json=spec, headers={"Prefer": "wait=300"}, timeout=600.0)
    panel(page, "copy").get_by_label("Copy as").select_option("curl")
    panel(page, "copy").get_by_label("File").select_option("npz")
    kinds = ["curl", "python", "solver", "command"]
    for kind in kinds:
        if (name, kind) in MISSING:
            panel(page, "copy").get_by_label("Copy as").select_option(kind)
            expect(panel(page, "copy").get_by_text("has no intersections")).to_be_visible()
            continue
        if kind == "curl" and shutil.which("curl") is None:
            continue
        folder = tmp_path / kind
        folder.mkdir()
        run(copied(page, kind), kind, folder)
        assert {file.name for file in folder.iterdir()} - {"domain.json"} == {"mesh.npz"}
        if kind != "solver":  # the same bytes; the solver alone does not write what the service adds
            assert (folder / "mesh.npz").read_bytes() == answer.content, kind
        else:
            assert (folder / "mesh.npz").stat().st_size > 1000
    made = httpx.get(f"{page_url}/v1/meshes", params={"limit": 10}).json()["items"]
    if "label" in spec:
        assert [mesh["label"] for mesh in made[:3]] == [ODD] * 3
    link = copied(page, "link")
    other = page.context.new_page()
    other.goto(link)
    assert json.loads(copied(other, "spec")) == spec


def test_a_link_of_a_stranger_puts_nothing_into_copies_that_would_run(page: Page) -> None:
    for spec in HOSTILE:
        command, *programs = page.evaluate(WRITTEN, spec)
        words = shlex.shlex(command, posix=True, punctuation_chars=True)
        words.commenters = ""
        assert not set(words) & {";", "#", "touch"}, command
        for program in programs:
            called = {ast.unparse(node.func) for node in ast.walk(ast.parse(program)) if isinstance(node, ast.Call)}
            assert PYTHON.rstrip("()") not in called, program


def test_a_program_names_the_class_of_every_kind_of_monitor(page: Page) -> None:
    for kind in MONITORS.documents:
        spec = {"monitor": {"kind": kind, "u": "x*y", "norm": "h1"}, "grid": {"n_xi": 9, "n_eta": 9}}
        _, program, _ = page.evaluate(WRITTEN, spec)
        name = "".join(map(str.capitalize, kind.split("_")))
        assert f"monitor={name}(" in program, program
        assert hasattr(equimesh_client, name)


def test_a_number_of_points_is_an_option_and_a_target(page: Page) -> None:
    points, blocks = {"grid": {"points": 400}}, {"domain": {"kind": "blocks", "vertices": {}, "blocks": []}}
    for asked in (points, {**points, **blocks}, {"target": {"error": None, "max_points": 400}}):
        command, program, _ = page.evaluate(WRITTEN, {"monitor": {"u": "x"}, **asked})
        assert "--points 400" in command
        assert "max_points=400" in program


def test_a_key_is_named_and_never_written(visit: Callable[..., Page]) -> None:
    page = visit("/#u=x*y&n=9&monitor=arc_length")
    box = panel(page, "key")
    box.get_by_label("API key").fill("emk_secret")
    box.get_by_role("button", name="Use this key").click()
    copy = panel(page, "copy")
    for kind, told in (("curl", '"Authorization: Bearer $EQUIMESH_KEY"'), ("python", 'os.environ["EQUIMESH_KEY"]')):
        copy.get_by_label("Copy as").select_option(kind)
        expect(copy.locator(".copy-text")).to_contain_text(told)
    assert "emk_secret" not in page.content()
    box.get_by_role("button", name="Forget it").click()
    expect(copy.locator(".copy-text")).not_to_contain_text("EQUIMESH_KEY")


def test_without_a_clipboard_the_text_is_selected(visit: Callable[..., Page]) -> None:
    page = visit("/#u=x*y&n=9&monitor=arc_length")
    page.evaluate("() => { navigator.clipboard.writeText = () => Promise.reject(new Error('closed')); }")
    copy = panel(page, "copy")
    copy.locator("button.primary").click()
    expect(copy.get_by_text("The text is selected")).to_be_visible()
    assert page.evaluate("String(getSelection())").startswith("curl ")
