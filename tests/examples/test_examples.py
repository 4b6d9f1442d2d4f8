"""The examples: they run without a warning, write what they say, and find what they claim."""

from __future__ import annotations

import io
import re
import runpy
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest

imread = pytest.importorskip("matplotlib.image").imread

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted((ROOT / "examples").glob("[0-9]*.py"))
TEN = ROOT / "examples" / "10_pictures_of_the_docs.py"
IMAGES = sorted((ROOT / "docs" / "images").glob("*.png"))
NUMBER = re.compile(r"-?\d+\.\d+(?:e[+-]\d+)?")
Run: TypeAlias = Callable[[str], str]


def run_example(number: str, folder: Path, *more: str, **smaller: str) -> str:
    """What the example of a number prints, run in this process as a program would be; its files go to ``folder``.

    ``smaller`` are other values for lines of its constants.
    """
    (script,) = (path for path in SCRIPTS if path.name.startswith(number))
    source, said, complained = script.read_text(), io.StringIO(), io.StringIO()
    for names, values in smaller.items():
        source, count = re.subn(
            rf"^{names.replace('__', ', ')} = .*$", f"{names.replace('__', ', ')} = {values}", source, flags=re.M
        )
        assert count == 1, names
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said), redirect_stderr(complained):
        patch.chdir(folder)
        patch.setattr(sys, "argv", [str(script), "--output", str(folder), *more])
        exec(compile(source, str(script), "exec"), {"__name__": "__main__", "__file__": str(script)})
    assert complained.getvalue().strip() == ""
    return said.getvalue()


# Constants of examples for an ordinary run, whose claims hold of smaller problems, too.
SMALLER = {
    "12": {"LAST": "6"},
    "24": {"N__STEPS__TURN__SIZE__K": "25, 6, 0.0625, 0.04, 0.01"},
    "26": {"N__FINER__DEBYE__DOPING__STEEP": "17, (33, 65), 0.01, 1e5, 80.0"},
}


@pytest.fixture
def run(tmp_path: Path, everything: bool) -> Run:
    """Runs the example of a number here, where warnings are errors, its files going to ``tmp_path``."""
    return lambda number: run_example(number, tmp_path, **({} if everything else SMALLER.get(number, {})))


@pytest.fixture
def run_alone(tmp_path: Path) -> Run:
    """As ``run``, in a process of its own, as users do: for the first example."""

    def run_script(number: str) -> str:
        (script,) = (path for path in SCRIPTS if path.name.startswith(number))
        command = [sys.executable, "-W", "error", str(script), "--output", str(tmp_path)]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
        assert (done.returncode, done.stderr.strip()) == (0, "")
        return done.stdout

    return run_script


@pytest.fixture(scope="module")
def three_monitors(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """What example 11 prints, and the folder of its pictures."""
    folder = tmp_path_factory.mktemp("monitors")
    return run_example("11", folder), folder


def check_picture(path: Path) -> None:
    image = imread(path)
    assert 500 < min(image.shape[:2]) <= max(image.shape[:2]) < 2000
    assert 0.01 < (image[..., :3].min(axis=-1) < 0.9).mean() < 0.9, "neither blank nor full"


def coarse(path: Path) -> np.ndarray:
    """The picture in squares of 30 pixels, in which a shift of a line by a pixel does not show."""
    image = imread(path)[..., :3]
    down, across = (size // 30 for size in image.shape[:2])
    return image[: 30 * down, : 30 * across].reshape(down, 30, across, 30, 3).mean(axis=(1, 3))


def check_kept(drawn: Path) -> None:
    """The picture in docs/images is the one drawn, give or take what another matplotlib draws otherwise."""
    kept = coarse(ROOT / "docs" / "images" / drawn.name)
    assert coarse(drawn).shape == kept.shape
    assert abs(coarse(drawn) - kept).max() < 0.12, "make it again with its script"


def rows(said: str, start: str) -> list[list[float]]:
    """The numbers of all lines that begin with ``start``."""
    return [[float(n) for n in NUMBER.findall(line)] for line in said.splitlines() if line.strip().startswith(start)]


def test_the_first_mesh_interpolates_better_than_the_uniform_one(run_alone: Run, tmp_path: Path) -> None:
    said = run_alone("01")
    assert "satisfies the equidistribution equations" in said
    assert 0 < rows(said, "smallest corner Jacobian")[0][0] < 1
    for error, uniform in rows(said, "interpolation error"):
        assert error < 0.5 * uniform
    check_picture(tmp_path / "first.png")
    assert b"Q_eq" in (tmp_path / "first.vtu").read_bytes()


def test_a_pde_on_the_mesh_has_a_smaller_error_than_on_uniform_ones(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("skfem")
    pytest.importorskip("equimesh_service")
    said = run("02")
    (adapted,), (uniform, finer) = rows(said, "adapted"), rows(said, "uniform")
    assert uniform[0] / adapted[0] > 10  # L2
    assert uniform[1] / adapted[1] > 6  # H1
    assert adapted[0] < finer[0]
    assert adapted[1] < finer[1]
    readme = (ROOT / "examples" / "README.md").read_text()
    for found, name in ((adapted, "adapted"), (uniform, "uniform |"), (finer, "uniform, finer")):
        assert rows(readme, f"| {name}")[0][-2:] == pytest.approx(found, rel=0.01)
    check_picture(tmp_path / "poisson.png")


@pytest.fixture(scope="class")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A service for several examples."""
    service = pytest.importorskip("equimesh_service")
    folder = tmp_path_factory.mktemp("service")
    with service.running(service.Settings(port=0, workers=1, data_dir=folder, log_level="warning")) as url:
        yield url


class TestWithAService:
    """Examples that use a service that is there already; the second example starts its own."""

    def test_a_mesh_from_samples_moves_nodes_into_the_interface(self, url: str, tmp_path: Path) -> None:
        said = run_example("03", tmp_path, "--url", url)
        inside, uniform = map(int, re.findall(r"(\d+) on the", said))
        assert inside > 1.5 * uniform
        check_picture(tmp_path / "drops.png")
        assert (tmp_path / "drops.vtu").stat().st_size > 10_000

    def test_a_mesh_that_follows_a_front_keeps_it_sharp(self, url: str, tmp_path: Path) -> None:
        errors = np.array(
            [
                list(map(float, line.split()))
                for line in run_example("15", tmp_path, "--url", url).splitlines()
                if line[:2] == "0."
            ]
        )
        assert errors.shape == (10, 3)
        assert np.all(errors[:, 2] > 8 * errors[:, 1])
        assert errors[-1, 1] < 1.1 * errors[0, 1]  # little is lost from mesh to mesh
        check_picture(tmp_path / "moving-front.png")

    def test_a_mesh_from_a_callable_sees_its_function(self, url: str, tmp_path: Path) -> None:
        said = run_example("04", tmp_path, "--url", url)
        assert rows(said, "at the nodes, the service's spline")[0][0] < 1e-4
        l2, uniform = rows(said, "interpolation error L2")[0]
        assert l2 < 0.5 * uniform
        check_picture(tmp_path / "clover.png")
        assert (tmp_path / "clover.h5").exists()


def test_an_own_loop_converges_from_the_mesh_before(run: Run, tmp_path: Path) -> None:
    said = run("05")
    moments = said.split("t = ")[1:]
    assert len(moments) == 3
    for moment in moments:
        assert 3 <= moment.count("iteration") <= 12
        assert rows(moment, "iteration")[-1][0] < 1e-6
    for name in ("loop.png", "loop_mesh.png"):
        check_picture(tmp_path / name)


def test_the_papers_mesh_is_that_of_the_single_domain(run: Run, tmp_path: Path) -> None:
    said = run("06")
    assert rows(said, "largest distance")[0][0] < 1e-9
    for number in (1, 2, 3):
        check_picture(tmp_path / f"figure{number}.png")


def test_classical_components_agree_and_overlap_helps(run: Run, tmp_path: Path) -> None:
    said = run("07")
    components = rows(said, "figure4.png")[0]
    assert len(components) == 4
    assert max(components) - min(components) < 0.02
    table = re.findall(r"^ +(\d) +(0\.\d+) +(0\.\d+)$", said, flags=re.MULTILINE)
    assert [overlap for overlap, *_ in table] == ["2", "4", "6", "8"]
    found, predicted = np.array([row[1:] for row in table], dtype=float).T
    assert (np.diff(found) < 0).all()
    assert found == pytest.approx(predicted, abs=0.01)
    for number in (4, 5):
        check_picture(tmp_path / f"figure{number}.png")


@pytest.mark.everything  # a table of many runs
def test_two_is_the_best_whole_p_and_the_nonlinear_condition_leads_up_to_it(run: Run, tmp_path: Path) -> None:
    said = run("08")
    lines = re.findall(r"^ *([\d.]+) +(\S+e-\d+) +(\S+e-\d+)$", said, flags=re.MULTILINE)
    linear, nonlinear = ({float(row[0]): float(row[k]) for row in lines} for k in (1, 2))
    assert sorted(linear) == [1, 2, 2.2, 3, 4, 5]
    for errors in (linear, nonlinear):
        assert sorted(errors, key=lambda p: errors[p])[:2] == [2.2, 2.0]
    assert [p for p in linear if nonlinear[p] < linear[p]] == [1, 2, 2.2]
    assert "best whole p is 2 (linear), 2 (nonlinear)" in said
    for number in (6, 7, 8):
        check_picture(tmp_path / f"figure{number}.png")


def test_table_1_and_the_order_of_the_three_methods(run: Run, tmp_path: Path) -> None:
    said = run("09")
    assert "the paper's table, digit for digit" in said
    assert rows((tmp_path / "table1.txt").read_text(), "Linear")[0][1:3] == [2.0076, 1.1979]
    classical, linear, nonlinear = rows(said, "figure9.png")[0]
    assert nonlinear < linear < 1e-6 * classical
    parallel, turns = rows(said, "classical error falls")[0]
    assert turns == pytest.approx(parallel**2, abs=0.01)
    check_picture(tmp_path / "figure9.png")


OF_OTHERS = {
    *("adapt-problems.png", "adapt.png", "against-refinement.png", "allen-cahn.png", "burgers-shock.png"),
    *("cylinder-wake.png", "schwarz-counts.png", "schwarz-errors.png", "schwarz-mismatch.png"),
}


def test_the_pictures_of_the_docs_are_those_of_the_scripts(
    run: Run, tmp_path: Path, three_monitors: tuple[str, Path], everything: bool
) -> None:
    if everything:
        run("10")
    drawn = [*tmp_path.glob("*.png"), *three_monitors[1].glob("*.png")]
    names, of_ten = {path.name for path in drawn}, re.findall(r'output / "([\w-]+\.png)"', TEN.read_text())
    assert {path.name for path in IMAGES} == OF_OTHERS | names | {*of_ten}
    assert len(names) == (len(of_ten) if everything else 0) + 1
    for path in IMAGES:
        check_picture(path)
        assert path.stat().st_size < 150_000
    for path in drawn:
        check_kept(path)


def test_least_error_interpolates_best_and_arc_length_least(three_monitors: tuple[str, Path]) -> None:
    said, _ = three_monitors
    gains = {name: rows(said, name)[0] for name in ("arc length", "curvature", "least error")}
    assert gains["curvature"][0] > 2 * gains["arc length"][0] > 4
    assert gains["least error"][0] > 1.3 * gains["curvature"][0]


def test_the_default_iteration_converges_where_the_papers_kinds_hardly_do(run: Run, tmp_path: Path) -> None:
    said = run("12")
    start, *_, last = rows(said, "classical")[0]
    assert last > 0.1 * start
    assert rows(said, "linear Robin")[0][3] > 0.1 * start
    assert rows(said, "optimized alone")[0][2] < 1e-3 * start
    assert rows(said, "default")[0][2] < 1e-8 * start
    check_picture(tmp_path / "schwarz-errors.png")


@pytest.mark.everything  # a table of many runs
def test_line_sums_make_iterations_independent_of_the_number_of_strips(run: Run, tmp_path: Path) -> None:
    said = run("13")
    page = (ROOT / "docs" / "background" / "schwarz-in-pictures.md").read_text()
    for data in ("local data", "line sums"):
        counts = re.findall(rf"{data}, \d strips .* (\d+)$", said, flags=re.MULTILINE)
        assert len(counts) == 3
        assert f"| {data} | {' | '.join(counts)} |" in page
    check_kept(tmp_path / "schwarz-mismatch.png")


@pytest.mark.everything  # a table of many runs
def test_the_page_has_the_counts_of_its_script(run: Run, tmp_path: Path) -> None:
    said, page = (
        {tuple(line.split(" | ")[:2]): line.strip(" |").split(" | ") for line in text.splitlines() if " | " in line}
        for text in (run("14"), (ROOT / "docs" / "background" / "schwarz-in-pictures.md").read_text())
    )
    assert len(said) == 1 + 6
    places = [page["| condition", "u"].index(cut) for cut in said["| condition", "u"][-2:]]
    for key, row in said.items():
        assert row[-2:] == [page[key][place] for place in places]
    check_picture(tmp_path / "schwarz-counts.png")


def test_a_loop_adapts_to_a_solution_that_only_the_solver_knows(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("skfem")
    said = run("16")
    rounds = np.array([list(map(float, line.split()[1:7])) for line in said.splitlines() if re.match(r" +\d ", line)])
    estimates, errors, gains = rounds[:, 0], rounds[:, 1], rounds[:, 3:5]
    assert gains[:, 0].max() > 100
    assert gains[:, 1].max() > 7
    assert estimates[2:] == pytest.approx(errors[2:], rel=0.6)  # the estimate is that of Poisson's equation
    assert "resolved: True" in said
    readme = (ROOT / "examples" / "README.md").read_text()
    told = rows(readme.replace("\n", " ").replace("**A sol", "\n**A sol").replace("**The p", "\n"), "**A solution that")
    assert told[0][:2] == pytest.approx([errors[0], errors.min()], rel=0.25)  # rounds differ between processors
    check_picture(tmp_path / "adapt.png")


@pytest.mark.everything  # seven loops
def test_loops_gain_on_seven_problems(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("skfem")
    said = run("17")
    least = {
        "A": (60, 7),
        "A200": (80, 9),
        "B": (1000, 25),
        "C": (50, 6),
        "D": (150, 10),
        "E": (2, 1.6),
        "A2": (2.8, 1.9),
    }
    found = {line.split()[0]: line.split() for line in said.splitlines() if line.split()[0] in least}
    assert [*found] == [*least]
    for name, (l2, h1) in least.items():
        assert float(found[name][1]) > l2
        assert float(found[name][2]) > h1
        assert found[name][4] == "True"
    check_picture(tmp_path / "adapt-problems.png")


@pytest.mark.everything  # a period of meshes; tests/docs/test_readme_numbers.py computes some of them again
def test_a_front_in_time_is_the_moving_picture_of_the_readme(run: Run, tmp_path: Path) -> None:
    said, readme = run("21"), (ROOT / "README.md").read_text()
    (gains,) = re.findall(r"error (\S+ to \S+) times smaller than on the uniform mesh", said)
    assert f"the error is {gains} times smaller" in readme
    new, kept = ((folder / "front-in-time.svg").read_text() for folder in (tmp_path, ROOT / "docs" / "images"))
    assert 4e4 < len(kept) < 6e5
    assert kept.count("<animate ") == 2
    assert re.sub(r"-?\d+", "", new).replace(" ", "") == re.sub(r"-?\d+", "", kept).replace(" ", "")
    places = [np.array([int(n) for n in re.findall(r"-?\d+", text)]) for text in (new, kept)]
    assert abs(places[0] - places[1]).max() <= 1  # rounding


@pytest.mark.everything  # many steps in time; tests/loops runs a few
@pytest.mark.parametrize(
    ("number", "picture"), [("18", "rotating-disc"), ("19", "burgers-shock"), ("20", "allen-cahn")]
)
def test_moving_meshes_have_the_errors_of_the_page(run: Run, tmp_path: Path, number: str, picture: str) -> None:
    if number == "20":
        pytest.importorskip("skfem")
    numbers = NUMBER.findall(run(number))
    told = (ROOT / "docs" / "how-to" / "moving-meshes.md").read_text()
    first = numbers[:2] if number != "20" else [numbers[0][:6], numbers[3][:6]]
    for found in first:
        assert found[:6] in told or f"{float(found):.1e}".replace("e-0", "e-") in told
    check_picture(tmp_path / f"{picture}.png")


def told_of_bodies() -> str:
    return (ROOT / "docs" / "how-to" / "flow-around-bodies.md").read_text()


@pytest.mark.everything  # a reference of 49 thousand cells; the next test runs the flow on a coarse mesh
def test_a_mesh_that_follows_the_speed_has_a_better_velocity_around_an_airfoil(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("skfem")
    said = run("23")
    (initial, *_), (finer, *_) = rows(said, "initial"), rows(said, "four times")
    *_, last = rows(said, "round")
    assert finer[1] < last[1] < 0.9 * initial[1]
    for name, found in (("initial", initial), ("four times the cells", finer), ("round 2", last)):
        assert rows(told_of_bodies(), f"| {name}")[0][-1] == pytest.approx(found[1], rel=0.02)
    check_picture(tmp_path / "airfoil.png")


def test_the_lift_of_an_airfoil_is_that_of_a_fine_mesh_on_a_coarse_one() -> None:
    pytest.importorskip("skfem")
    (script,) = (path for path in SCRIPTS if path.name.startswith("23"))
    example = runpy.run_path(str(script))
    psi, speed, lift = example["flow"](example["airfoil"](0.5).mesh)
    assert lift == pytest.approx(0.965, rel=0.02)
    assert lift > 2 * np.pi * np.sin(example["ANGLE"])  # a thick airfoil has more lift than a thin one
    assert len(psi) == len(speed)
    assert 1.5 < speed.max() < 4


def test_every_example_is_short_and_in_the_index() -> None:
    readme = (ROOT / "examples" / "README.md").read_text()
    assert [path.name[:2] for path in SCRIPTS] == [f"{number:02}" for number in range(1, len(SCRIPTS) + 1)]
    for path in SCRIPTS:
        assert len(path.read_text().splitlines()) < 120
        assert f"[{path.name}]({path.name})" in readme


@pytest.mark.parametrize(
    ("number", "picture", "errors", "gain"),
    [
        ("24", "moving-heat-source", r"adapted (?P<own>\S+), uniform (?P<uniform>\S+),", 6.0),
        ("25", "layer-with-suction", r"adapted: L2 error (?P<own>\S+),[^u]+uniform: L2 error (?P<uniform>\S+),", 70.0),
        ("26", "diode", r"error: adapted (?P<own>\S+)%, uniform (?P<uniform>\S+)%", 12.0),
        (
            "27",
            "two-materials",
            r"uniform: [^\d]+2 error (?P<uniform>\S+)%[^$]*interface: [^\d]+2 error (?P<own>\S+)%",
            7.0,
        ),
    ],
)
def test_tutorials_of_a_field_have_a_smaller_error(
    run: Run, tmp_path: Path, number: str, picture: str, errors: str, gain: float
) -> None:
    pytest.importorskip("skfem")
    found = re.search(errors, run(number))
    assert float(found["uniform"]) > gain * float(found["own"])
    check_picture(tmp_path / f"{picture}.png")
