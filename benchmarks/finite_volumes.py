"""Finite volumes on adapted meshes: OpenFOAM and FiPy run for real, and their errors at the cell centres.

apt-get install openfoam; pip install fipy
python benchmarks/finite_volumes.py --functions paper ring20 --points 33 65
python benchmarks/finite_volumes.py --write      # all of it, into docs/how-to/finite-volumes.md

FiPy may be that of another Python: ``--fipy /path/to/python``.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import finite_volumes_cases as cases

import equimesh as em
from equimesh.meshes.mesh import Mesh

PAGE = Path(__file__).resolve().parent.parent / "docs" / "how-to" / "finite-volumes.md"
BEGIN, END = "<!-- written by benchmarks/finite_volumes.py -->\n", "<!-- end -->\n"
TUNED = ("paper", "ring20", "tanh60", "wave30", "gauss", "layers")
"""The functions on which the candidates were chosen most."""
GOALS = {"paper": 8.0, "ring20": 1.7, "tanh60": 1.5, "wave30": 1.1, "gauss": 1.0, "layers": 20.0}
"""Gains at 65 x 65 points that a test requires."""
FUNCTIONS = {
    "paper": "(1-exp(15*(x-1)))*sin(pi*y)",
    "ring20": "tanh(20*((x-0.5)**2+(y-0.5)**2-0.09))",
    "tanh60": "tanh(60*(x+y/2-0.75))",
    "wave30": "tanh(30*(y-0.5-0.25*sin(2*pi*x)))",
    "gauss": "exp(-50*((x-0.5)**2+(y-0.5)**2))",
    "layers": "exp(-x/0.01)+exp(-y/0.01)",
    "diagonal": "tanh(25*(x-y))",
    "ridge": "exp(-100*(x-0.3)**2)*sin(3*y)",
    "arc": "atan(30*((x-1.2)**2+(y-0.1)**2-0.8))",
    "waves": "sin(4*x+2*y)+exp(-40*(x+y-1)**2)",
    "side": "exp((x-1)/0.02)*y+cos(2*x)",
    "parabola": "tanh(15*(x**2-y))+0.3*exp(-200*((x-0.8)**2+(y-0.2)**2))",
}
"""u by name; the candidates were chosen on all of them, mostly on those in ``TUNED``."""


class Row(NamedTuple):
    """The measurements of one function on one grid."""

    name: str
    points: int
    uniform: float
    ours: float
    angle: float
    checked: bool
    last: float


def measured(name: str, points: int) -> Row:
    """The errors of OpenFOAM on the uniform mesh and on that of the preset."""
    u = em.Expression(FUNCTIONS[name])
    grid = em.Grid(n_xi=points, n_eta=points)
    solution = em.solve(em.Problem(monitor=em.Auto(u=u, purpose="finite_volume"), grid=grid))
    with tempfile.TemporaryDirectory() as folder:
        uniform = cases.open_foam(Path(folder) / "uniform", Mesh.uniform(grid), u)
        ours = cases.open_foam(Path(folder) / "ours", solution.mesh, u)
        checked = cases.check_mesh(Path(folder) / "ours")
    if not abs(checked.angle - solution.faces.non_orthogonality) < 1e-4:
        raise AssertionError(f"checkMesh has {checked.angle}, the certificate {solution.faces.non_orthogonality}")
    return Row(
        name,
        points,
        uniform.error,
        ours.error,
        checked.angle,
        checked.passed,
        ours.last,
    )


def table(rows: list[Row]) -> str:
    """The rows as a table of Markdown."""
    head = "| u | points | uniform | preset | gain | angle | `checkMesh` |\n|" + "---|" * 7
    lines = [
        f"| {r.name} | {r.points} | {r.uniform:.2e} | {r.ours:.2e} | {r.uniform / r.ours:.2f} |"
        f" {r.angle:.0f} |"
        f" {'ok' if r.checked else 'fails'} |"
        for r in rows
    ]
    return "\n".join([head, *lines]) + "\n"


def fipy_table(python: str, points: int) -> str:
    """The errors of FiPy with its plain and its corrected term, next to those of OpenFOAM."""
    lines = ["| u | mesh | OpenFOAM | FiPy, corrected | FiPy, plain |\n|---|---|---|---|---|"]
    grid = em.Grid(n_xi=points, n_eta=points)
    for name in TUNED:
        u = em.Expression(FUNCTIONS[name])
        monitors: dict[str, Any] = {
            "preset": em.Auto(u=u, purpose="finite_volume"),
            "rectilinear": em.LeastError(u=u, rectilinear=True),
        }
        for kind, monitor in monitors.items():
            mesh = em.solve(em.Problem(monitor=monitor, grid=grid)).mesh
            with tempfile.TemporaryDirectory() as folder:
                foam = cases.open_foam(Path(folder) / "case", mesh, u)
            corrected, plain = cases.fipy(python, mesh, u)
            lines.append(f"| {name} | {kind} | {foam.error:.2e} | {corrected:.2e} | {plain:.2e} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, print, and write into the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--functions", nargs="+", choices=tuple(FUNCTIONS), default=tuple(FUNCTIONS))
    parser.add_argument("--points", nargs="+", type=int, default=(65,))
    parser.add_argument("--fipy", metavar="PYTHON", default=sys.executable, help="a Python that has FiPy")
    parser.add_argument("--write", action="store_true", help="into docs/how-to/finite-volumes.md")
    options = parser.parse_args()
    if shutil.which("electrostaticFoam") is None:
        raise SystemExit("OpenFOAM is missing: apt-get install openfoam")
    rows = []
    for name in options.functions:
        for points in options.points if name in TUNED else [65]:
            rows.append(measured(name, points))
            print(table(rows[-1:]).splitlines()[-1], flush=True)
    text = f"{cases.version()}, error at the cell centres of the Poisson problem with the solution u:\n\n{table(rows)}"
    print(text)
    if cases.has_fipy(options.fipy):
        print(
            f"65 x 65 points, OpenFOAM and FiPy {cases.fipy_version(options.fipy)}:\n\n{fipy_table(options.fipy, 65)}"
        )
    if options.write:
        before, _, rest = PAGE.read_text().partition(BEGIN)
        PAGE.write_text(before + BEGIN + text + END + rest.partition(END)[2])


if __name__ == "__main__":
    main()
