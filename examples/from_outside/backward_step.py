"""Where the stream reattaches behind a backward step: OpenFOAM on a mesh of three blocks that follows the velocity.

    pip install 'equimesh[solver,plot]'
    python backward_step.py

simpleFoam computes the laminar flow at a Reynolds number of 100. The mesh goes to it as one layer of cells with named
patches. Errors are those against a fine mesh.
"""

import argparse
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

import equimesh as em
from equimesh.io import write_mesh
from equimesh_coupling import node_values

ENVIRONMENT = {"WM_PROJECT_DIR": "/usr/share/openfoam", **os.environ}
DEFAULTS = {"refine": 1.0, "fine": 3.0, "rounds": 2}  # 1 has 2816 cells, 8 a step height, and 3 has 25,344
# Finite volumes need even cells with lines that cross at nearly right angles.
WEIGHTS = {"distortion": 4, "smoothness": 100}
WALLS = ("floor", "wall")
AT = {"i": (-2, (1, 5)), "e": (0, (0, 1, 5)), "o": (16, (0, 1, 5))}  # inlet, edge of the step, outlet: x, and all y
FILES = {
    "system/controlDict": "application simpleFoam; startFrom startTime; startTime 0; stopAt endTime; endTime 3000;"
    " deltaT 1; writeControl timeStep; writeInterval 3000; writeFormat ascii; writePrecision 10;",
    "system/fvSchemes": "ddtSchemes { default steadyState; } gradSchemes { default leastSquares; }"
    " divSchemes { default Gauss linear; div(phi,U) bounded Gauss linearUpwind grad(U); }"
    " laplacianSchemes { default Gauss linear corrected; } snGradSchemes { default corrected; }"
    " interpolationSchemes { default skewCorrected linear; }",
    "system/fvSolution": "solvers { p { solver GAMG; smoother DICGaussSeidel; tolerance 1e-9; relTol 0.02; }"
    " U { solver smoothSolver; smoother symGaussSeidel; tolerance 1e-10; relTol 0.05; } }"
    " SIMPLE { consistent yes; nNonOrthogonalCorrectors 2; residualControl { p 1e-6; U 1e-6; } }"
    " relaxationFactors { equations { U 0.8; } fields { p 0.9; } }",
    "constant/transportProperties": "transportModel Newtonian; nu 0.01;",
    "constant/turbulenceProperties": "simulationType laminar;",
}
HEAD = "FoamFile {{ version 2.0; format ascii; class {}; object {}; }}\n"


def step(refine: float = 1) -> em.Blocks:
    """A stream of height 4 over a step of height 1, which ends at x = 0."""
    return em.Blocks.of(
        {
            "vertices": {f"{name}{y}": [x, y] for name, (x, ys) in AT.items() for y in ys},
            "blocks": [
                {"name": "before", "corners": ["i1", "e1", "e5", "i5"], "cells": [8, 32]},
                {"name": "above", "corners": ["e1", "o1", "o5", "e5"], "cells": [64, None]},
                {"name": "behind", "corners": ["e0", "o0", "o1", "e1"], "cells": [None, 8]},
            ],
            "sides": {
                "inlet": [["i1", "i5"]],
                "outlet": [["o0", "o1"], ["o1", "o5"]],
                "floor": [["e0", "o0"]],
                "wall": [["i1", "e1"], ["e1", "e0"]],
                "top": [["o5", "e5"], ["e5", "i5"]],
            },
            "refine": refine,
        }
    )


def profile(y: np.ndarray) -> np.ndarray:
    """The velocity on the inlet: a layer at the wall, and the stream above it."""
    return np.tanh(3 * (y - 1))


def flow(mesh: em.Mesh, case: Path) -> np.ndarray:
    """The velocity in the cells by OpenFOAM, shape ``(m, 2)``."""
    count = len(mesh.cells)
    data = em.MeshData(mesh=mesh, u=None, q_eq=np.zeros(count), subdomain=np.zeros(count, dtype=int))
    shutil.rmtree(case, ignore_errors=True)  # it may have a flow of another mesh
    case.mkdir(parents=True)
    write_mesh(case, data, format="foam")
    y = mesh.points[mesh.sides["inlet"]][..., 1].mean(axis=1)
    rows = " ".join(f"({u} 0 0)" for u in profile(y))
    given, free = f"fixedValue; value nonuniform List<vector> {len(y)} ({rows})", "zeroGradient"
    kinds = {
        "U": {"inlet": given, "outlet": free, "top": "slip", **dict.fromkeys(WALLS, "noSlip")},
        "p": {"inlet": free, "outlet": "fixedValue; value uniform 0", "top": free, **dict.fromkeys(WALLS, free)},
    }
    texts = {name: HEAD.format("dictionary", Path(name).name) + text for name, text in FILES.items()}
    for name, kind, zero, units in (("U", "Vector", "(0 0 0)", "0 1 -1"), ("p", "Scalar", "0", "0 2 -2")):
        patches = " ".join(f"{side} {{ type {of}; }}" for side, of in kinds[name].items())
        texts[f"0/{name}"] = HEAD.format(f"vol{kind}Field", name) + (
            f"dimensions [{units} 0 0 0 0]; internalField uniform {zero};"
            f" boundaryField {{ {patches} frontAndBack {{ type empty; }} }}"
        )
    for name, text in texts.items():
        (case / name).parent.mkdir(parents=True, exist_ok=True)
        (case / name).write_text(text)
    done = subprocess.run(["simpleFoam", "-case", case], env=ENVIRONMENT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stdout[-2000:] + done.stderr)
    last = max(int(path.name) for path in case.iterdir() if path.name.isdigit())
    found = re.search(r"internalField.*?\n\((.*?)\n\)", (case / str(last) / "U").read_text(), re.DOTALL)
    if found is None:
        raise RuntimeError(f"no velocity in {case / str(last)}")
    return np.array(re.sub("[()]", " ", found[1]).split(), dtype=float).reshape(-1, 3)[:, :2]


def at_nodes(mesh: em.Mesh, velocity: np.ndarray) -> em.QuadField:
    """The velocity along the stream, from the cells to the nodes, and as given on the inlet and the walls."""
    values = node_values(em.CellAverages(np.ascontiguousarray(velocity[:, 0])), mesh)
    values[np.unique(np.concatenate([mesh.sides[name] for name in WALLS]))] = 0
    inlet = np.unique(mesh.sides["inlet"])
    values[inlet] = profile(mesh.points[inlet, 1])
    return em.QuadField(mesh=mesh, values=values)


def reattachment(mesh: em.Mesh, velocity: np.ndarray) -> float:
    """x where the shear on the floor changes its sign, by parabolas through the wall and the lower two cells."""
    centres, x = mesh.points[mesh.cells].mean(axis=1), mesh.points[mesh.sides["floor"]][..., 0].mean(axis=1)
    (near, low), (far, high) = (
        [np.interp(x, centres[row, 0], of) for of in (velocity[row, 0] / centres[row, 1], centres[row, 1])]
        for row in mesh.block_cells[2].T[:2]
    )
    shear = near * high - far * low
    turn = np.flatnonzero((shear[:-1] < 0) & (shear[1:] >= 0))[-1]
    return float(np.interp(0, shear[turn : turn + 2], x[turn : turn + 2]))


def draw(mesh: em.Mesh, velocity: np.ndarray, initial: em.Mesh, path: Path) -> None:
    figure = Figure(figsize=(9, 7), layout="constrained")
    speed = at_nodes(mesh, velocity)
    for axes, of, title in zip(figure.subplots(2, 1), (initial, mesh), ("initial", "adapted"), strict=True):
        values = speed.evaluate(*of.points[of.cells].mean(axis=1).T)[0]
        cells = PolyCollection(of.points[of.cells], array=values, cmap="coolwarm", edgecolor="0.2", linewidth=0.3)
        axes.add_collection(cells)
        axes.set(title=title, aspect="equal", xlim=(-2, 9), ylim=(0, 4))
    figure.savefig(path, dpi=80)


def main(output: Path, refine: float, fine: float, rounds: int) -> None:
    domain, finest = step(refine), step(fine).mesh
    exact = flow(finest, output / "fine")
    u, x = at_nodes(finest, exact), reattachment(finest, exact)
    print(f"reference of {len(finest.cells)} cells: reattachment at x = {x:.3f}")

    def say(name: str, mesh: em.Mesh) -> np.ndarray:
        velocity = flow(mesh, output / name)
        wrong = velocity[:, 0] - u.evaluate(*mesh.points[mesh.cells].mean(axis=1).T)[0]
        error, at = np.sqrt(wrong**2 @ mesh.cell_areas()), reattachment(mesh, velocity)
        print(f"{name}: {len(mesh.cells)} cells, x = {at:.3f}, error {at - x:+.3f}, of the velocity {error:.2e}")
        return velocity

    say("finer", step(2 * refine).mesh)
    mesh = domain.mesh
    velocity = say("initial", mesh)
    for number in range(1, rounds + 1):
        monitor = em.LeastError(u=at_nodes(mesh, velocity), **WEIGHTS)
        mesh = em.solve(em.Problem(monitor=monitor, domain=domain), initial=mesh, check=False).mesh
        velocity = say(f"round{number}", mesh)
    draw(mesh, velocity, domain.mesh, output / "backward-step.png")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    for name, value in DEFAULTS.items():
        parser.add_argument(f"--{name}", type=type(value), default=value)
    main(**vars(parser.parse_args()))
