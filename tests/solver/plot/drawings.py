"""One picture of every kind, what they are drawn from, and what can be read of an SVG: its texts and colours."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from equimesh.meshes.mesh import Grid, Mesh
from equimesh.meshes.mesh_data import MeshData
from equimesh.plot.convergence import draw_convergence, draw_histories
from equimesh.plot.meshes import (
    SUBDOMAIN_COLOURS,
    draw_comparison,
    draw_decomposition,
    draw_mesh,
    draw_quality,
    draw_surface,
)
from equimesh.quality.comparison import ComparedMesh, UniformComparison
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.schwarz.decomposition import Decomposition

RED, BLUE = SUBDOMAIN_COLOURS[:2]


def strips(n_xi: int = 12, n_eta: int = 10, overlap: int = 4) -> Decomposition:
    return Decomposition(grid=Grid(n_xi=n_xi, n_eta=n_eta), subdomains=(2, 1), overlap=overlap)


def result(decomposition: Decomposition) -> MeshData:
    """A curved mesh with a bump for u, and cells owned as the decomposition has it."""
    start = Mesh.uniform(decomposition.grid)
    bump = np.sin(np.pi * start.x) * np.sin(np.pi * start.y)
    mesh = Mesh(start.x + 0.1 * bump, start.y - 0.05 * bump)
    area = mesh.corner_jacobians().mean(axis=0)
    return MeshData(mesh=mesh, u=bump, q_eq=area / area.mean(), subdomain=decomposition.owner_of_cells())


def convergence(count: int, *, errors: bool = True, subdomains: int = 2) -> dict[str, Any]:
    """The JSON of a made-up Schwarz iteration."""
    return {
        "iterations": [
            {
                "iteration": k,
                "max_q_eq": 1.2 + 0.4 * 0.5**k,
                "change": None if k == 0 else 0.3**k,
                "error": 0.5**k if errors else None,
                "min_jacobian": 0.5,
                "subdomains": [
                    {
                        "subdomain": s,
                        "newton_steps": 3,
                        "status": "converged",
                        "error_x": 0.5**k if errors else None,
                        "error_y": 0.4**k / 3 if errors else None,
                    }
                    for s in range(subdomains)
                ],
            }
            for k in range(count)
        ],
        "rate": 0.5,
        "predicted_rate": None,
    }


def compared(gain: float | None = 13.125, n_xi: int = 12, n_eta: int = 10) -> UniformComparison:
    """Two meshes with made-up errors, each of another size; without a u where there is no gain."""
    data = result(strips(n_xi, n_eta))
    uniform = Mesh.uniform(data.mesh.grid)
    error = np.full(data.q_eq.shape, 1e-2) if gain else None

    def part(mesh: Mesh, size: float) -> ComparedMesh:
        return ComparedMesh(mesh=mesh, q_eq=data.q_eq, u=data.u, error=None if error is None else size * error)

    errors = InterpolationErrors(l2=1.0, l2_uniform=gain, h1=1.0, h1_uniform=1.0) if gain else None
    return UniformComparison(adapted=part(data.mesh, 0.1), uniform=part(uniform, 1.0), interpolation=errors)


def texts(path: Path) -> str:
    """All text of an SVG: matplotlib keeps it as comments beside the outlines."""
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    tree = ElementTree.parse(path, parser)
    return "\n".join(node.text or "" for node in tree.iter() if node.tag is ElementTree.Comment)


def colours(path: Path) -> set[str]:
    """All stroke colours of an SVG."""
    styles = ";".join(node.get("style", "") for node in ElementTree.parse(path).iter())
    return {part.split(":")[1].strip() for part in styles.split(";") if part.strip().startswith("stroke:")}


DRAWINGS: dict[str, Callable[[Path], None]] = {
    "mesh": lambda path: draw_mesh(result(strips()), path, decomposition=strips()),
    "decomposition": lambda path: draw_decomposition(strips(), path),
    "quality": lambda path: draw_quality(result(strips()), path),
    "surface": lambda path: draw_surface(result(strips()), path),
    "comparison": lambda path: draw_comparison(compared(), path),
    "convergence": lambda path: draw_convergence(convergence(8), path),
    "histories": lambda path: draw_histories({"one": [1, 0.1], "two": [1, 0.2]}, path, title="Two"),
}
