"""Draws the small pictures of the gallery, which the page shows without a solve.

    .venv/bin/python deploy/gallery_pictures.py

It writes the nodes of coarse meshes, and u there. Run it after a change of
`service/equimesh_service/workbench/gallery.json`. Tests compare the file with the solver.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

import equimesh as em
from equimesh import specs

FOLDER = Path(__file__).parents[1] / "service" / "equimesh_service" / "workbench"
PICTURES = FOLDER / "gallery_pictures.json"
COARSER = 3  # the grids of the problems are this many times finer
SIZE = 240  # whole numbers of coordinates on the longer side of the box
SHADES = 9  # u goes from 0 to this


def problems() -> list[dict[str, Any]]:
    """The problems of the gallery."""
    found: list[dict[str, Any]] = json.loads((FOLDER / "gallery.json").read_text())["problems"]
    return found


def solve(problem: dict[str, Any]) -> em.Solution[Any]:
    """The mesh of a problem with fewer points."""
    spec = problem["spec"]
    if "grid" in spec:
        coarse = {"grid": {name: number // COARSER + 1 for name, number in spec["grid"].items()}}
    else:
        coarse = {"domain": {**spec["domain"], "refine": 1 / COARSER}}
    return specs.build({**spec, **coarse}).solve()


def picture(solution: em.Solution[Any]) -> dict[str, Any]:
    """A picture: its ``size``, and the ``shape``, coordinates of ``nodes`` from the top, and ``u`` there as digits.

    A mesh of blocks has these three for each of its ``blocks``.
    """
    mesh = solution.mesh
    u = solution.data().u
    assert u is not None
    low = np.array([mesh.x.min(), mesh.y.min()])
    high = np.array([mesh.x.max(), mesh.y.max()])
    scale = SIZE / (high - low).max()
    nodes = np.rint(np.stack([(mesh.x - low[0]) * scale, (high[1] - mesh.y) * scale], axis=-1)).astype(int)
    shades = np.rint((u - u.min()) / np.ptp(u) * SHADES).astype(int)
    size = np.ceil((high - low) * scale).astype(int).tolist()
    if mesh.is_grid:
        return {"size": size, **part(nodes, shades)}
    return {"size": size, "blocks": [part(nodes[block], shades[block]) for block in mesh.blocks]}


def part(nodes: Any, shades: Any) -> dict[str, Any]:
    """The grid of a mesh, or one of its blocks."""
    return {
        "shape": list(shades.shape),
        "nodes": nodes.ravel().tolist(),
        "u": "".join(map(str, shades.ravel())),
    }


if __name__ == "__main__":
    drawn = {problem["name"]: picture(solve(problem)) for problem in problems()}
    lines = [f"  {json.dumps(name)}: {json.dumps(one, separators=(',', ':'))}" for name, one in drawn.items()]
    PICTURES.write_text("{\n" + ",\n".join(lines) + "\n}\n")
    print(f"wrote {PICTURES.name}: {PICTURES.stat().st_size} bytes")
