"""FreeFEM reads a mesh of triangles, says what it holds, and solves on it, in one run of its program."""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import poisson

PROGRAM = "FreeFem++-nw"
FORMATS = ("mesh", "msh")
# Its plane meshes have triangles only.
CELLS = ("triangle",)
SIDES = {1: "left", 2: "right", 3: "bottom", 4: "top"}
# Debian does not tell FreeFEM where its plugins are.
ENVIRONMENT = {**os.environ, "FF_LOADPATH": os.environ.get("FF_LOADPATH", "/usr/lib/freefem++")}
SCRIPT = """
mesh Th = @read@;
fespace Vh(Th, P1);
Vh u, v;
func w = tanh(@steep@*(x + @slant@*y - @place@));
func slope = @steep@*(1 - w^2);
func source = 2*@steep@^2*(1 + @slant@^2)*w*(1 - w^2);
solve poisson(u, v) = int2d(Th, qforder=8)(dx(u)*dx(v) + dy(u)*dy(v)) - int2d(Th, qforder=8)(source*v)
    - int1d(Th, 2, qforder=8)(slope*(N.x + @slant@*N.y)*v) + on(1, 3, 4, u=w);
{
    ofstream points("points");
    points.precision(17);
    for (int i = 0; i < Th.nv; i++) points << Th(i).x << " " << Th(i).y << " " << u[][i] << endl;
    ofstream cells("cells");
    for (int k = 0; k < Th.nt; k++) cells << Th[k][0] << " " << Th[k][1] << " " << Th[k][2] << endl;
    ofstream edges("edges");
    for (int k = 0; k < Th.nbe; k++)
        edges << int(Th.be(k)[0]) << " " << int(Th.be(k)[1]) << " " << Th.be(k).label << endl;
}
"""


def version() -> str:
    """The version that the program prints first; it exits with an error, since it gets no script."""
    said = subprocess.run([PROGRAM], capture_output=True, text=True, check=False).stdout
    found = re.search(r"version\s*:?\s*([\d.]+)", said)
    return found.group(1) if found else ""


VERSION = version()


def read(path: str) -> dict[str, Any]:
    """All that the program writes of a mesh."""
    is_gmsh = path.endswith(".msh")
    words = {
        "read": f'gmshload("{path}")' if is_gmsh else f'readmesh("{path}")',
        "steep": poisson.STEEP,
        "slant": poisson.SLANT,
        "place": poisson.PLACE,
    }
    text = re.sub(r"@(\w+)@", lambda found: str(words[found.group(1)]), SCRIPT)
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "script.edp"
        script.write_text(('load "gmsh"\n' if is_gmsh else "") + text)
        done = subprocess.run(
            [PROGRAM, "-ne", "-v", "0", script.name], cwd=folder, capture_output=True, text=True, env=ENVIRONMENT
        )
        if done.returncode:
            raise RuntimeError(f"{PROGRAM} failed: {done.stdout[-2000:]}{done.stderr[-2000:]}")
        return {name: np.loadtxt(Path(folder) / name) for name in ("points", "cells", "edges")}


def facts(mesh: dict[str, Any]) -> dict[str, Any]:
    cells, edges = mesh["cells"].astype(int), mesh["edges"].astype(int)
    x, y = mesh["points"][cells, :2].transpose(2, 0, 1)
    areas = (x * np.roll(y, -1, 1) - y * np.roll(x, -1, 1)).sum(axis=1) / 2
    sides = {side: np.unique(edges[edges[:, 2] == label, :2]) for label, side in SIDES.items()}
    return {"points": mesh["points"][:, :2], "area": areas.sum(), "smallest": areas.min(), "sides": sides}


def solve(mesh: dict[str, Any]) -> Any:
    return mesh["points"][:, 2]
