"""A Poisson problem with a known solution, run by OpenFOAM and by FiPy on a mesh of ours."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import equimesh as em
from equimesh.io import write_mesh
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array
from equimesh.quality.faces import place_centres

CORRECTIONS = 40
"""Corrections for non-orthogonality: the solve is repeated so often."""
SIDES = ("left", "right", "bottom", "top")
HEAD = "FoamFile\n{{\n version 2.0;\n format ascii;\n class {kind};\n object {name};\n}}\n"
CONTROL = """application electrostaticFoam; startFrom startTime; startTime 0; stopAt endTime; endTime {end}; deltaT 1;
writeControl timeStep; writeInterval {end}; writeFormat ascii; writePrecision 16; timeFormat general;
"""
SCHEMES = """ddtSchemes {default Euler;} gradSchemes {default Gauss linear;} divSchemes {default Gauss upwind;}
laplacianSchemes {default Gauss linear corrected;} interpolationSchemes {default linear;}
snGradSchemes {default corrected;}
"""
SOLVERS = """solvers { phi {solver GAMG; smoother DICGaussSeidel; tolerance 1e-13; relTol 1e-4; maxIter 200;}
rho {solver PBiCGStab; preconditioner none; tolerance 1e-10; relTol 0;} }
"""
# With a mobility of charges of 0 this solver has one Poisson equation, which it solves again in every step.
PROPERTIES = "epsilon0 epsilon0 [-1 -3 4 0 0 2 0] 1;\nk k [-1 0 2 0 0 1 0] 0;\n"
FIPY = """
import sys
import fipy
import numpy as np
from equimesh_coupling.adaptors.fipy import mesh_of
from equimesh_coupling.parts import MeshParts
d = np.load(sys.argv[1])
sides = {name: d[name] for name in ("left", "right", "bottom", "top")}
mesh = mesh_of(MeshParts(points=d["points"], cells=d["cells"], sides=sides, shape=tuple(d["shape"])))
assert abs(np.asarray(mesh.cellVolumes) - d["volume"]).max() < 1e-12 * d["volume"].max()
for term in (fipy.DiffusionTermCorrection, fipy.DiffusionTerm):
    value = fipy.CellVariable(mesh=mesh, value=0.0)
    x, y = np.asarray(mesh.faceCenters)
    for name in sides:
        mask = np.asarray(mesh.physicalFaces[name])
        at = np.flatnonzero(mask)
        near = np.argmin(np.hypot(x[at][:, None] - d["x_sides"], y[at][:, None] - d["y_sides"]), axis=1)
        held = np.zeros(mask.size)
        held[at] = d["u_sides"][near]
        value.constrain(fipy.FaceVariable(mesh=mesh, value=held), mask)
    source = fipy.CellVariable(mesh=mesh, value=d["source"])
    equation = term(1.0) == source
    for _ in range(int(sys.argv[2]) if term is fipy.DiffusionTermCorrection else 1):
        equation.solve(var=value, solver=fipy.LinearLUSolver())
    error = np.asarray(value.value) - d["u"]
    print(np.sqrt((d["volume"] * error**2).sum() / d["volume"].sum()))
"""


class Solved(NamedTuple):
    """The L2 norm of the error at the cell centres over the root of the area, and the last initial residual."""

    error: float
    last: float


class Checked(NamedTuple):
    """What ``checkMesh`` prints: the angle, and whether all checks pass."""

    angle: float
    passed: bool


class Poisson(NamedTuple):
    """u and its Laplacian at the cell centres, the volumes, and u at the middles of the edges of the sides."""

    u: Array
    source: Array
    volume: Array
    sides: dict[str, tuple[Array, Array, Array]]

    @classmethod
    def of(cls, mesh: Mesh, u: em.Expression, *, at_centroids: bool = True) -> Poisson:
        """The problem on the cells of a mesh, in their order.

        The centre of a cell is its centroid, as for OpenFOAM, or the mean of its corners, as for FiPy.
        """
        x, y = (np.ascontiguousarray(q) for q in (mesh.x, mesh.y))
        centres = np.empty((2, x.shape[0] - 1, x.shape[1] - 1))
        place_centres(x, y, centres[0], centres[1])
        if not at_centroids:
            centres = np.stack([0.25 * (q[1:, 1:] + q[1:, :-1] + q[:-1, 1:] + q[:-1, :-1]) for q in (x, y)])
        at = u.evaluate(centres[0], centres[1], order=2)
        volume = 0.5 * (
            (x[1:, 1:] - x[:-1, :-1]) * (y[:-1, 1:] - y[1:, :-1])
            - (y[1:, 1:] - y[:-1, :-1]) * (x[:-1, 1:] - x[1:, :-1])
        )
        sides = {}
        for name in SIDES:
            ends = mesh.points[mesh.sides[name]]
            middle_x, middle_y = np.ascontiguousarray(ends.mean(axis=1).T)
            sides[name] = (middle_x, middle_y, u.evaluate(middle_x, middle_y)[0])
        return cls(at[0].ravel(), (at[3] + at[5]).ravel(), volume.ravel(), sides)

    def error(self, found: Array) -> float:
        """The L2 norm of the error of values at the cell centres, over the root of the area."""
        return float(np.sqrt((self.volume * (found - self.u) ** 2).sum() / self.volume.sum()))


def open_foam(case: Path, mesh: Mesh, u: em.Expression) -> Solved:
    """The error of OpenFOAM's ``electrostaticFoam`` with ``Gauss linear corrected``."""
    problem = Poisson.of(mesh, u)
    for folder in ("0", "constant", "system"):
        (case / folder).mkdir(parents=True)
    shape = mesh.x.shape[0] - 1, mesh.x.shape[1] - 1
    data = em.MeshData(mesh=mesh, u=None, q_eq=np.ones(shape), subdomain=np.zeros(shape, dtype=np.int64))
    write_mesh(case, data)
    end = CORRECTIONS + 1
    for name, text in (("controlDict", CONTROL.format(end=end)), ("fvSchemes", SCHEMES), ("fvSolution", SOLVERS)):
        (case / "system" / name).write_text(HEAD.format(kind="dictionary", name=name) + text)
    (case / "constant" / "physicalProperties").write_text(
        HEAD.format(kind="dictionary", name="physicalProperties") + PROPERTIES
    )
    fixed = {name: f"type fixedValue; value {_numbers(values)};" for name, (_, _, values) in problem.sides.items()}
    _field(case, "phi", "[1 2 -3 0 0 -1 0]", "uniform 0", fixed)
    free = dict.fromkeys(SIDES, "type zeroGradient;")
    _field(case, "rho", "[0 -3 1 0 0 1 0]", _numbers(-problem.source), free)
    done = _run("electrostaticFoam", "-case", str(case))
    residuals = re.findall(r"Solving for phi, Initial residual = (\S+),", done)
    text = (case / str(end) / "phi").read_text()
    listed = re.search(r"internalField\s+nonuniform List<scalar>\s*\d+\s*\(([^)]*)\)", text)
    if listed is None:
        raise AssertionError("the field of OpenFOAM has no list of values")
    return Solved(problem.error(np.array(listed[1].split(), dtype=float)), float(residuals[-1]))


def check_mesh(case: Path) -> Checked:
    """What ``checkMesh`` says with all its checks."""
    text = _run("checkMesh", "-case", str(case), "-allTopology", "-allGeometry")
    angle = re.search(r"non-orthogonality Max: (\S+)", text)
    if angle is None:
        raise AssertionError(text[-2000:])
    return Checked(float(angle[1]), "Mesh OK" in text)


def fipy(python: str, mesh: Mesh, u: em.Expression) -> tuple[float, float]:
    """The errors of FiPy with ``DiffusionTermCorrection`` and with its plain ``DiffusionTerm``."""
    problem = Poisson.of(mesh, u, at_centroids=False)
    sides = [np.concatenate(parts) for parts in zip(*problem.sides.values(), strict=True)]
    parts = mesh.mesh_parts()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.npz"
        arrays: dict[str, Any] = {**parts.sides, **problem._asdict()}
        del arrays["sides"]
        arrays |= dict(zip(("x_sides", "y_sides", "u_sides"), sides, strict=True))
        np.savez(path, points=parts.points, cells=parts.cells, shape=np.array(parts.shape), **arrays)
        client = str(Path(__file__).resolve().parent.parent / "client")
        done = subprocess.run(
            [python, "-c", FIPY, str(path), str(CORRECTIONS)],
            env={**os.environ, "PYTHONPATH": client},
            capture_output=True,
            text=True,
            check=True,
        )
    corrected, plain = map(float, done.stdout.split())
    return corrected, plain


def version() -> str:
    """The name and version of OpenFOAM: its programs print it first, also when they find no case."""
    found = re.search(r"OPENFOAM=(\w+)", _run("checkMesh", "-case", os.devnull) + _run("checkMesh"))
    return f"OpenFOAM {found[1]}" if found else "OpenFOAM"


def fipy_version(python: str) -> str:
    """The version of FiPy."""
    return subprocess.run(
        [python, "-c", "import fipy; print(fipy.__version__)"], capture_output=True, text=True, check=True
    ).stdout.strip()


def _field(case: Path, name: str, units: str, inside: str, sides: dict[str, str]) -> None:
    every = "".join(f" {side} {{ {text} }}\n" for side, text in {**sides, "frontAndBack": "type empty;"}.items())
    text = f"dimensions {units};\ninternalField {inside};\nboundaryField\n{{\n{every}}}\n"
    (case / "0" / name).write_text(HEAD.format(kind="volScalarField", name=name) + text)


def _numbers(values: Array) -> str:
    return f"nonuniform List<scalar> {values.size} ( {' '.join(repr(float(value)) for value in values)} )"


def _run(*command: str) -> str:
    env = {"WM_PROJECT_DIR": "/usr/share/openfoam", **os.environ}
    return subprocess.run(command, env=env, capture_output=True, text=True, check=False).stdout


def has_fipy(python: str) -> bool:
    """Whether this Python is one that has FiPy."""
    if shutil.which(python) is None:
        return False
    return subprocess.run([python, "-c", "import fipy"], capture_output=True, check=False).returncode == 0
