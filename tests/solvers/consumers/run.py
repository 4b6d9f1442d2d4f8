"""What one consumer does with all meshes of a folder, as a JSON file there: run.py NAME FOLDER.

It runs in the environment of the consumers, and knows `equimesh_coupling` alone of the project.
"""

from __future__ import annotations

import importlib
import json
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from equimesh_coupling import BadValues, Coupled, MeshParts, element_points, element_values, node_values

# Consumers that read files only.
WITHOUT_ADAPTOR = ("vtk", "gmsh", "meshio", "freefem", "dealii", "openfoam", "paraview")
SIDES = ("left", "right", "bottom", "top")


class Given(Coupled):
    """A mesh as the code in the docs has it."""

    def __init__(self, parts: MeshParts) -> None:
        self._parts = parts

    def mesh_parts(self, cells: Any = None) -> MeshParts:
        return self._parts.mesh_parts(cells)


def parts_of(path: Path) -> MeshParts:
    """The arrays of a mesh."""
    with np.load(path) as file:
        n_xi, n_eta = file["shape"].tolist()
        return MeshParts(
            points=file["points"], cells=file["cells"], sides={side: file[side] for side in SIDES}, shape=(n_xi, n_eta)
        )


def our_nodes(points: Any, nodes: Any, close: float) -> list[int]:
    """The number of every point among our nodes, -1 where there is none; ``close`` allows for numbers read as text."""
    if close:
        distances = np.abs(points[:, None, :] - nodes).max(axis=2)
        return [int(k) if far <= close else -1 for k, far in zip(distances.argmin(1), distances.min(1), strict=True)]
    number = {tuple(point): k for k, point in enumerate(nodes.tolist())}
    return [number.get(tuple(point), -1) for point in points.tolist()]


def outcome(consumer: Any, mesh: Any, parts: MeshParts, values_too: bool) -> dict[str, Any]:
    """What the mesh of the consumer holds; its values at our nodes, and the error at its cells where it has one."""
    facts = consumer.facts(mesh)
    points = np.asarray(facts["points"], dtype=float)
    ours = our_nodes(points, parts.points, getattr(consumer, "CLOSE", 0.0))
    found: dict[str, Any] = {
        "nodes": ours,
        "area": float(facts["area"]),
        "smallest": float(facts["smallest"]),
        "sides": {
            side: sorted(ours[node] for node in np.asarray([*nodes]).tolist()) for side, nodes in facts["sides"].items()
        },
    }
    if values_too:
        solution = consumer.solve(mesh)
        found["values"] = node_values(solution, parts).tolist()
        if hasattr(consumer, "error"):
            found["error"] = consumer.error(mesh, solution)
    return found


def refused(fields: list[Any], parts: MeshParts) -> list[str]:
    """The sentences with which fields are refused that are no nodal values on the mesh."""
    sentences = []
    for field in fields:
        try:
            node_values(field, parts)
        except BadValues as error:
            sentences.append(str(error))
        else:
            raise AssertionError(f"{field!r} was taken")
    return sentences


def main(name: str, folder: Path) -> None:
    consumer = importlib.import_module(f"with_{name}")
    adaptor = name not in WITHOUT_ADAPTOR
    hand_over = importlib.import_module(f"equimesh_coupling.adaptors.{name}").mesh_of if adaptor else None
    if hasattr(consumer, "COMM"):
        hand_over = partial(hand_over, comm=consumer.COMM)
    solves = hasattr(consumer, "solve")
    found: dict[str, Any] = {"version": consumer.VERSION, "meshes": {}}
    for path in sorted(folder.glob("*.npz")):
        parts = parts_of(path)
        if ("triangle" if parts.is_triangular else "quad") not in getattr(consumer, "CELLS", ("quad", "triangle")):
            continue
        ways: dict[str, Any] = {}
        if adaptor:
            ways["adaptor"] = outcome(consumer, hand_over(parts), parts, solves)
        for suffix in consumer.FORMATS:
            file = path.with_suffix(f".{suffix}")
            if file.exists():
                ways[suffix] = outcome(consumer, consumer.read(str(file)), parts, solves)
        found["meshes"][path.stem] = ways
    small = parts_of(folder / "adapted square quads.npz")
    found["takes_fields"] = adaptor
    if hasattr(consumer, "linear"):
        field = consumer.linear(hand_over(small))
        found["carried"] = bool(np.allclose(node_values(field, small).ravel(), small.points @ [1.0, 2.0]))
    if hasattr(consumer, "quadratic"):
        for cells in getattr(consumer, "CELLS", ("quad", "triangle")):
            cut = small.mesh_parts(cells)
            values, *element = element_values(consumer.quadratic(hand_over(cut)), cut)
            x, y = element_points(cut, 2, cells).T
            is_carried = element == [2, cells] and np.allclose(values.ravel(), x * x + 2.0 * y)
            found["carried"] = bool(is_carried and found.get("carried", True))
    found["refused"] = refused(consumer.strangers(small), small) if adaptor else []
    code = folder / f"{name}.py"  # of the page about this consumer
    if code.exists():
        names: dict[str, Any] = {"mesh": Given(small)}
        exec(compile(code.read_text(), str(code), "exec"), names)
        found["documented"] = np.shape(names.get("at_nodes", np.zeros(small.shape))) == small.shape
    (folder / f"{name}.json").write_text(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
