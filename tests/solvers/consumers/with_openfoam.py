"""OpenFOAM checks a mesh, says what it holds, and solves the Poisson problem on it, with w given on all four sides."""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import poisson

from equimesh_coupling import CellAverages

FORMATS = ("foam.zip",)
# OpenFOAM does not round the last digit of a number that it reads as text.
CLOSE = 1e-15
SIDES = ("left", "right", "bottom", "top")
# Debian's package does not set where OpenFOAM is.
ENVIRONMENT = {**os.environ, "WM_PROJECT_DIR": os.environ.get("WM_PROJECT_DIR", "/usr/share/openfoam")}
# Corrections of the gradient normal to the faces; each is a time step of electrostaticFoam.
CORRECTORS = 40
# How far a point is from that of a VTK file, in which OpenFOAM writes numbers of single precision.
FEW_DIGITS = 1e-5
CONTROL = f"""
application electrostaticFoam; startFrom startTime; startTime 0; stopAt endTime; endTime {CORRECTORS}; deltaT 1;
writeControl timeStep; writeInterval {CORRECTORS}; writeFormat ascii; writePrecision 17;
"""
SCHEMES = """
ddtSchemes { default Euler; } gradSchemes { default Gauss linear; } divSchemes { default Gauss upwind; }
laplacianSchemes { default Gauss linear corrected; } interpolationSchemes { default linear; }
snGradSchemes { default corrected; }
"""
SOLUTION = """
solvers
{
    phi { solver PCG; preconditioner DIC; tolerance 1e-12; relTol 0; }
    rho { solver PBiCGStab; preconditioner DILU; tolerance 1e-12; relTol 0; }
}
PISO {}
"""
# electrostaticFoam solves -laplacian(phi) = rho/epsilon0, with units of electricity; with k = 0 rho stays as it is.
PROPERTIES = "epsilon0 epsilon0 [-1 -3 4 0 0 2 0] 1; k k [-1 0 2 0 0 1 0] 0;"
OF_POTENTIAL, OF_CHARGE = "dimensions [1 2 -3 0 0 -1 0];", "dimensions [0 -3 1 0 0 1 0];"


def run(case: Path, *command: str) -> str:
    """What a program of OpenFOAM prints in a case."""
    done = subprocess.run(
        command, cwd=case, capture_output=True, text=True, env={**ENVIRONMENT, "PWD": str(case)}, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{command[0]} failed: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.stdout


def version() -> str:
    """The version of Debian's package: its programs print none."""
    query = ["dpkg-query", "-W", "-f", "${Version}", "openfoam"]
    return subprocess.run(query, capture_output=True, text=True, check=False).stdout.partition(".")[0]


VERSION = version()


def dictionary(path: Path, kind: str, text: str) -> None:
    """Write a file of a case."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"FoamFile {{ version 2.0; format ascii; class {kind}; object {path.name}; }}\n{text}\n")


def read(path: str) -> Path:
    """A case with the mesh, which checkMesh has passed."""
    case = Path(tempfile.mkdtemp(prefix="case-", dir=Path.cwd()))
    with zipfile.ZipFile(path) as archive:
        archive.extractall(case)
    for name, text in (("controlDict", CONTROL), ("fvSchemes", SCHEMES), ("fvSolution", SOLUTION)):
        dictionary(case / "system" / name, "dictionary", text)
    (case / "0").mkdir()
    said = run(case, "checkMesh", "-allTopology", "-allGeometry")
    if "Mesh OK." not in said:
        raise RuntimeError(f"checkMesh: {said[-3000:]}")
    run(case, "transformPoints", "-scale", "(1 1 1)")
    run(case, "postProcess", "-func", "writeCellCentres", "-time", "0")
    run(case, "postProcess", "-func", "writeCellVolumes", "-time", "0")
    run(case, "foamToVTK", "-legacy", "-ascii", "-time", "0")
    return case


def numbers_of(text: str, name: str = "internalField") -> Any:
    """The numbers of a nonuniform list in a field of OpenFOAM, one row for each cell or face."""
    body = re.search(name + r"\s+nonuniform List<\w+>\s*\d+\s*\((.*?)\n\)", text, re.S)
    if body is None:
        raise RuntimeError(f"no list {name} in {text[:300]}")
    rows = [row.strip("()").split() for row in body.group(1).splitlines() if row]
    return np.array(rows, dtype=float)


def volumes_of(case: Path) -> Any:
    """The volumes of the cells, which OpenFOAM writes as one number where they are equal."""
    text = (case / "0" / "V").read_text()
    equal = re.search(r"internalField\s+uniform ([^;]+);", text)
    if equal is None:
        return numbers_of(text)[:, 0]
    return np.full(len(numbers_of((case / "0" / "C").read_text())), float(equal.group(1)))


def all_points(case: Path) -> Any:
    """The points that OpenFOAM has read and written again."""
    text = (case / "constant" / "polyMesh" / "points").read_text()
    body = text[text.index("\n(") + 2 : text.rindex("\n)")]
    return np.array([row.strip("()").split() for row in body.splitlines() if row], dtype=float)


def points_of(path: Path) -> Any:
    """The points of a legacy VTK file."""
    words = path.read_text().split("POINTS", 1)[1].split()
    count = int(words[0])
    return np.array(words[2 : 2 + 3 * count], dtype=float).reshape(-1, 3)


def facts(case: Path) -> dict[str, Any]:
    """Points and volumes as OpenFOAM writes them; the points of a patch come from a file with fewer digits."""
    points = all_points(case)
    thick = points[:, 2].max()
    below = points[points[:, 2] == 0.0, :2]
    volumes = volumes_of(case)
    sides = {}
    for side in SIDES:
        (patch,) = (case / "VTK" / side).glob("*.vtk")
        distances = np.linalg.norm(points_of(patch)[:, None, :2] - below, axis=2)
        assert distances.min(axis=1).max() < FEW_DIGITS
        sides[side] = np.unique(distances.argmin(axis=1))
    return {"points": below, "area": volumes.sum() / thick, "smallest": volumes.min(), "sides": sides}


def solve(case: Path) -> Any:
    """The averages over the cells."""
    centres = numbers_of((case / "0" / "C").read_text())
    x, y, _ = centres.T
    boundary = ["frontAndBack { type empty; }"]
    at_faces = (case / "0" / "C").read_text().split("boundaryField", 1)[1]
    for side in SIDES:
        middles = numbers_of(at_faces.split(side, 1)[1], "value")
        values = " ".join(map(repr, poisson.w(*middles.T[:2]).tolist()))
        boundary.append(f"{side} {{ type fixedValue; value nonuniform List<scalar> ({values}); }}")
    free = " ".join(f"{side} {{ type zeroGradient; }}" for side in SIDES)
    free += " frontAndBack { type empty; }"
    load = "\n".join(map(repr, poisson.load(x, y).tolist()))
    sides = " ".join(boundary)
    dictionary(
        case / "0" / "phi", "volScalarField", f"{OF_POTENTIAL} internalField uniform 0; boundaryField {{ {sides} }}"
    )
    dictionary(
        case / "0" / "rho",
        "volScalarField",
        f"{OF_CHARGE} internalField nonuniform List<scalar> ({load}); boundaryField {{ {free} }}",
    )
    dictionary(case / "constant" / "physicalProperties", "dictionary", PROPERTIES)
    run(case, "electrostaticFoam")
    return CellAverages(numbers_of((case / str(CORRECTORS) / "phi").read_text())[:, 0])


def error(case: Path, solution: Any) -> float:
    """The error at the centres of the cells, in L2: what OpenFOAM solves for."""
    centres = numbers_of((case / "0" / "C").read_text())
    volumes = volumes_of(case)
    thick = all_points(case)[:, 2].max()
    difference = solution.values - poisson.w(*centres.T[:2])
    return float(np.sqrt((volumes / thick * difference**2).sum()))
