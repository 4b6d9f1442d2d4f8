"""Every number in the README is what the code gives: each has a check here, and a number without one fails.

A number is one in digits or in words. Code is left out, since it is run; its comments are not. Numbers that take long
are compared with the table that a benchmark wrote, and a part of the table is computed again.
"""

from __future__ import annotations

import json
import math
import re
import runpy
import tomllib
from collections.abc import Callable
from contextlib import chdir
from pathlib import Path
from typing import Any

import pytest
import yaml
from random_functions import random_functions

import equimesh as em

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
BENCHMARKS = (ROOT / "benchmarks" / "least_error.md").read_text()
GALLERY = ROOT / "service" / "equimesh_service" / "workbench" / "gallery.json"
WORDS = (
    "two",
    "three",
    "four",
    "five",
    "six",
    "seven",
    "eight",
    "nine",
    "ten",
    "eleven",
    "twelve",
    "thirteen",
    "fourteen",
)
"""Numbers in words, from two on."""
LARGE_WORDS = ("twenty", "thirty", "fifty", "hundred", "thousand", "half")
NUMBER = re.compile(rf"(?<![\w.])\d+(?:[.,]\d+)*(?!\w)|\b(?:{'|'.join(WORDS + LARGE_WORDS)})\b", re.IGNORECASE)
SEED = 12
"""The seed of the random functions in the table of the benchmarks."""
RECOMPUTED = 8
"""Random functions that are measured again."""
NEAR = 0.05
"""Descents amplify rounding: gains of one mesh differ by some percent from processor to processor."""


def prose(text: str) -> str:
    """The words of a page in one line: without code and addresses, but with the comments of code and with alt texts."""
    text = re.sub(r"(?ms)^```\w*\n(.*?)^```$", lambda code: " ".join(_comments(code[1])), text)
    text = re.sub(r"`[^`\n]*`", " ", text)
    text = re.sub(r"\]\([^)\s]*\)", "] ", text)
    text = re.sub(r"<!--.*?-->", " ", text)
    text = re.sub(r'<img [^>]*alt="([^"]*)"[^>]*>', r"\1", text)
    return re.sub(r"\s+", " ", text)


def _comments(code: str) -> list[str]:
    return re.findall(r"(?<=  # ).*", code)


def unknown_numbers(text: str) -> list[str]:
    """The numbers of a text that no check knows, with the words around them."""
    known = [match.span() for pattern in CHECKS for match in re.finditer(pattern, text)]
    return [
        text[max(0, match.start() - 30) : match.end() + 30]
        for match in NUMBER.finditer(text)
        if not any(first <= match.start() and match.end() <= last for first, last in known)
    ]


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> em.Solution:
    """What the Python of the README computes."""
    (code,) = re.findall(r"^```python\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)
    names: dict[str, Any] = {}
    with chdir(tmp_path_factory.mktemp("readme")):
        exec(compile(code, "README.md", "exec"), names)
        assert Path("mesh.vtu").is_file()
    solution = names["solution"]
    assert isinstance(solution, em.Solution)
    return solution


def check_gain(shown: em.Solution, told: str) -> None:
    assert shown.against_uniform.gain == pytest.approx(float(told), rel=NEAR)
    assert shown.interpolation.gain_l2 == shown.against_uniform.gain


def check_solver(shown: em.Solution, told: str) -> None:
    assert shown.solver_gain.l2 == pytest.approx(float(told), rel=NEAR)


def check_grid(shown: em.Solution, n_xi: str, n_eta: str) -> None:
    assert shown.problem.grid.shape == (int(n_xi), int(n_eta))


def row(what: str) -> tuple[float, str]:
    """The value and the note of a row in the tables of the benchmarks."""
    ((value, note),) = re.findall(rf"^{re.escape(what)} +(\S+) *(.*)$", BENCHMARKS, re.MULTILINE)
    return float(value), str(note)


def check_random_functions(_: em.Solution, count: str, gain: str, n_xi: str, n_eta: str) -> None:
    assert f"`random_functions.py --seed {SEED}`, on {n_xi} x {n_eta} points" in BENCHMARKS
    for way in ("norm l2", "auto"):
        mean, note = row(f"{count} random functions, {way}: geometric mean L2 gain")
        assert mean == pytest.approx(float(gain), rel=0.1)
        assert row(f"{count} random functions, {way}: gain below 1 in L2")[0] == 0
        assert float(note.removeprefix("smallest ").partition(",")[0]) > 1
    again = []
    for function in random_functions(SEED, RECOMPUTED):
        grid = em.Grid(n_xi=int(n_xi), n_eta=int(n_eta))
        solution = em.solve(em.Problem(monitor=em.LeastError(u=em.Expression(function.u)), grid=grid))
        again.append(solution.interpolation.gain_l2)
    assert min(again) > 1
    assert math.exp(sum(map(math.log, again)) / RECOMPUTED) == pytest.approx(float(gain), rel=0.5)


def check_gallery(_: em.Solution, told: str) -> None:
    assert WORDS.index(told) + 2 == len(json.loads(GALLERY.read_text())["problems"])


def check_front(_: em.Solution, moments: str, smallest: str, largest: str) -> None:
    example = runpy.run_path(str(ROOT / "examples" / "21_front_in_time.py"))
    assert example["FRAMES"] == int(moments)
    points, gains = example["POINTS"], []
    for frame in (0, 2, 5, 8):
        problem = em.Problem(
            monitor=example["monitor"](frame / example["FRAMES"]), grid=em.Grid(n_xi=points, n_eta=points)
        )
        solution = em.solve(problem)
        gains.append(solution.interpolation.gain_l2)
    assert (min(gains), max(gains)) == pytest.approx((float(smallest), float(largest)), rel=NEAR)


def check_plate(_: em.Solution, told: str) -> None:
    example = runpy.run_path(str(ROOT / "examples" / "10_pictures_of_the_docs.py"))
    problem = em.Problem(monitor=em.LeastError(u=em.Expression(example["WAVE"])), domain=example["plate"]())
    solution = em.solve(problem)
    assert solution.interpolation.gain_l2 == pytest.approx(float(told), rel=NEAR)


def check_python(_: em.Solution, told: str) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["requires-python"] == f">={told}"


def check_commands(_: em.Solution, told: str) -> None:
    assert WORDS.index(told.lower()) + 2 == len(re.findall(r"^<!-- \w+ -->\n```sh$", README, re.MULTILINE))


CHECKS: dict[str, Callable[..., None]] = {
    r"coloured by error: ([\d.]+) times smaller": check_gain,
    r"([\d.]+) times smaller error of a solver": check_solver,
    r"A solver's error is ([\d.]+) times smaller on the adapted one": check_solver,
    r"mesh of a wave, coloured by error, ([\d.]+) times smaller": check_plate,
    r"Both meshes have (\d+) x (\d+) points": check_grid,
    r"interpolation of (\d+) random functions was about (\d+) times smaller \(geometric mean, (\d+) x (\d+) points\)": (
        check_random_functions
    ),
    r"has (\w+) more problems": check_gallery,
    r"At (\d+) moments the error is ([\d.]+) to ([\d.]+) times smaller than on the uniform mesh": check_front,
    r"Python ([\d.]+) or newer": check_python,
    r"## (\w+) commands": check_commands,
}
"""The words around each number, which are its groups, and its check."""


@pytest.mark.parametrize("pattern", CHECKS)
def test_a_number_is_what_the_code_gives(pattern: str, shown: em.Solution) -> None:
    (match,) = re.finditer(pattern, prose(README))
    CHECKS[pattern](shown, *match.groups())


def test_the_readme_has_no_number_without_a_check() -> None:
    assert unknown_numbers(prose(README)) == []


@pytest.mark.parametrize("new", ["17 times quicker", "in 0.5 s", "seven formats", "up to 300,000 points", "# 3 lines"])
def test_a_new_number_is_noticed(new: str) -> None:
    comment = f"```sh\nequimesh demo  {new}\n```\n" if new.startswith("#") else new
    assert len(unknown_numbers(prose(f"{README}\n{comment}\n"))) == 1


def test_code_and_addresses_hold_no_numbers_of_the_prose() -> None:
    assert unknown_numbers(prose("L2, 2D, `n=33`, [a page](docs/0009.md)\n\n```py\nn = 33\n```\n")) == []


def test_the_citation_is_of_this_version_in_both_places() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert cited["version"] == version
    assert f"version = {{{version}}}" in README
    (paper,) = cited["references"]
    for words in (paper["title"].replace("2D", "{2D}"), paper["collection-title"], str(paper["year"])):
        assert words in README
