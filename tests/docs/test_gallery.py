"""The gallery: its code makes its pictures, solves the problems of the workbench, and its links open them there."""

from __future__ import annotations

import json
import re
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

import numpy as np
import pytest

import equimesh as em
from equimesh import specs
from equimesh.domains.domain import map_mesh

imread = pytest.importorskip("matplotlib.image").imread

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "gallery.md").read_text()
KEPT = ROOT / "docs" / "images" / "gallery"
PROBLEMS = json.loads((ROOT / "service" / "equimesh_service" / "workbench" / "gallery.json").read_text())["problems"]
NAMES = [problem["name"] for problem in PROBLEMS]
SECTION = re.compile(
    r"^## (?P<title>.+)\n\n(?P<sentence>.+)\n\n!\[(?P<alt>.+)\]\(images/gallery/(?P<name>[\w-]+)\.png\)\n\n"
    r"```py\n(?P<code>(?:.*\n)+?)```\n\n\[Open it in the workbench\]\(http://127\.0\.0\.1:8000/#(?P<hash>\S+)\)$",
    re.MULTILINE,
)
SECTIONS = {match["name"]: match for match in SECTION.finditer(PAGE)}
MAX_BYTES = 2_000_000
"""Of all pictures together."""
MAX_LINES = 13
"""Of the code of a picture."""
NEAR = 0.2
"""Descents amplify rounding: their gains differ by up to a tenth from processor to processor."""


# Without --everything every fifth picture is drawn; the code of the others is read, and has to make their problem.
DRAWN = [pytest.param(name, marks=[pytest.mark.everything] if k % 5 else []) for k, name in enumerate(NAMES)]


@pytest.fixture(scope="module")
def drawing(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Path, float]]:
    """Draws the picture of a name by the code of the page; gives its file and its gain."""
    example = runpy.run_path(str(ROOT / "examples" / "22_gallery.py"))
    folder = tmp_path_factory.mktemp("gallery")

    def draw(name: str) -> tuple[Path, float]:
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            return folder / f"{name}.png", example["draw"](name, example["blocks"]()[name])

    return draw


def coarse(path: Path) -> np.ndarray:
    """The picture in squares of 30 pixels."""
    image = imread(path)[..., :3]
    down, across = (size // 30 for size in image.shape[:2])
    return image[: 30 * down, : 30 * across].reshape(down, 30, across, 30, 3).mean(axis=(1, 3))


def test_the_page_has_the_problems_of_the_workbench_in_their_order() -> None:
    assert [*SECTIONS] == NAMES
    assert PAGE.count("\n## ") == len(NAMES)
    for problem in PROBLEMS:
        section = SECTIONS[problem["name"]]
        assert (section["title"], section["sentence"]) == (problem["title"], problem["sentence"])
        assert len(section["code"].splitlines()) <= MAX_LINES
        assert f'src="images/gallery/{problem["name"]}.png" width="170" alt="{problem["title"]}"' in PAGE


@pytest.mark.parametrize("name", DRAWN)
def test_the_code_of_a_picture_draws_it(name: str, drawing: Callable[[str], tuple[Path, float]]) -> None:
    path, gain = drawing(name)
    new, kept = coarse(path), coarse(KEPT / f"{name}.png")
    assert new.shape == kept.shape
    assert abs(new - kept).mean() < 0.02, "make it again with examples/22_gallery.py"
    told = re.search(r"the error is (\S+) times smaller$", SECTIONS[name]["alt"])
    assert float(told[1]) == pytest.approx(gain, rel=NEAR), "write it again with examples/22_gallery.py --page"


@pytest.mark.parametrize("problem", PROBLEMS, ids=NAMES)
def test_the_code_of_a_picture_solves_the_problem_of_the_workbench(problem: dict[str, Any]) -> None:
    code = SECTIONS[problem["name"]]["code"].partition("solution = ")[0]
    names: dict[str, Any] = {}
    exec(compile(code, problem["name"], "exec"), names)
    mine, its = names["problem"], specs.build(problem["spec"]).problem
    assert type(mine.monitor) is type(its.monitor)
    if isinstance(its.domain, em.Blocks):
        meshes = [one.domain.mesh for one in (mine, its)]
    else:
        assert (mine.grid, mine.boundary) == (its.grid, its.boundary)
        meshes = [map_mesh(em.Mesh.uniform(one.grid), one.domain) for one in (mine, its)]
    assert np.array_equal(meshes[0].points, meshes[1].points)
    values = [one.monitor.u.evaluate(meshes[0].x, meshes[0].y)[0] for one in (mine, its)]
    assert np.array_equal(*values)


@pytest.mark.parametrize("problem", PROBLEMS, ids=NAMES)
def test_the_link_of_a_picture_is_the_state_of_the_workbench(problem: dict[str, Any]) -> None:
    words = parse_qs(SECTIONS[problem["name"]]["hash"], strict_parsing=True)
    assert {name: json.loads(text) for name, (text,) in words.items()} == {
        "spec": problem["spec"],
        "sliders": problem["sliders"],
    }


def test_the_pictures_are_small_and_sharp() -> None:
    pictures = sorted(KEPT.glob("*"))
    assert [path.stem for path in pictures] == sorted(NAMES)
    assert sum(path.stat().st_size for path in pictures) < MAX_BYTES
    for path in pictures:
        assert imread(path).shape[1] == 1050  # three pixels for each of a phone that is 350 wide
