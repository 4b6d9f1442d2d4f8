"""What a worker adds to the mesh of a step of a sequence: its displacement, its fields, and what the step answers."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import equimesh
from equimesh.io.npz import load_npz
from equimesh_service.assembly.step_fields import StepField, read_fields
from equimesh_service.files.port import Files
from equimesh_service.problems.problem import Problem
from equimesh_service.store.rows import FAILED, SUCCEEDED, MeshInput

# The names of the displacement in files: the first that is not the name of a field.
VELOCITIES = ("velocity", "mesh_velocity")


@dataclass(frozen=True)
class StepStart:
    """The mesh of the step before, and the fields on it."""

    mesh: equimesh.Mesh
    fields: Mapping[str, StepField]

    @classmethod
    def of(cls, mesh_input: MeshInput, files: Files) -> "StepStart | None":
        """The start of a step; None for the first step, and for a mesh that is no step."""
        if mesh_input.start is None:
            return None
        try:
            with files.local(mesh_input.start) as path:
                mesh = load_npz(path).mesh
        except FileNotFoundError:
            raise Problem("conflict", "The mesh that this step starts from was deleted.") from None
        if mesh_input.fields is None:
            return cls(mesh, {})
        with files.local(mesh_input.fields) as path:
            return cls(mesh, read_fields(path))

    def arrived(self, data: equimesh.MeshData, solution: equimesh.Solution) -> equimesh.MeshData:
        """The data of the new mesh with its displacement, the fields carried to it, and the JSON of the step."""
        carried = self._carried(data.mesh)
        moved = np.stack([data.mesh.x - self.mesh.x, data.mesh.y - self.mesh.y], axis=-1)
        name = next((name for name in VELOCITIES if name not in self.fields), None)
        at_nodes = {key: values for key, values in carried.items() if self.fields[key].location == "nodes"}
        in_cells = {key: values for key, values in carried.items() if key not in at_nodes}
        return replace(
            data,
            fields=at_nodes if name is None else {**at_nodes, name: moved},
            cell_fields=in_cells,
            step=json.dumps(self._answer(solution, name), allow_nan=False),
        )

    def _carried(self, mesh: equimesh.Mesh) -> dict[str, Any]:
        """The fields on the new mesh."""
        return equimesh.transfer(self.mesh, {name: field.mesh_values() for name, field in self.fields.items()}, mesh)

    def _answer(self, solution: equimesh.Solution, velocity: str | None) -> dict[str, Any]:
        """The status, certificate and warnings of the mesh, the name of its displacement, and how fields came."""
        certificate = solution.certificate.summary()
        return {
            "status": SUCCEEDED if solution.status.succeeded else FAILED,
            "certificate": certificate,
            "warnings": certificate["warnings"],
            "velocity": velocity,
            "fields": {
                name: {"transfer": field.transfer, "location": field.location, "bounds": field.bounds}
                for name, field in self.fields.items()
            },
        }
