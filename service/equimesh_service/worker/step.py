"""A step of a sequence in a worker: its mesh, its fields, and what it says of itself."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import equimesh
from equimesh.equations.block_problem import BlockProblem
from equimesh.errors import InputError
from equimesh.io.npz import load_npz
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.sequences.sequence_step import BlockStep
from equimesh.solving.options import SolveArguments
from equimesh.specs import build_field
from equimesh.specs.spec import BuiltSpec
from equimesh_service.assembly.samples import field_of
from equimesh_service.assembly.step_fields import StepField, read_fields
from equimesh_service.files.port import Files
from equimesh_service.problems.problem import Problem
from equimesh_service.store.rows import SUCCEEDED, MeshInput

# The names of the displacement in files: the first that is not the name of a field.
VELOCITIES = ("velocity", "mesh_velocity")
# The settings of a step that a sequence takes.
MOTION = ("smoothing", "max_move", "outrun")
AnySequenceStep: TypeAlias = equimesh.SequenceStep | BlockStep
"""A step on a grid, or on blocks."""


@dataclass(frozen=True, kw_only=True)
class StepStart:
    """The mesh of the step before, the fields on it, what else is known of it, and how the mesh is to move."""

    mesh: equimesh.Mesh | QuadMesh
    fields: Mapping[str, StepField]
    earlier: equimesh.Earlier | None
    motion: Mapping[str, Any]

    @classmethod
    def of(cls, mesh_input: MeshInput, spec: BuiltSpec, files: Files) -> "StepStart | None":
        """The start of a step; None for the first step, and for a mesh that is no step."""
        if mesh_input.start is None:
            return None
        try:
            with files.local(mesh_input.start) as path:
                mesh = load_npz(path).mesh
        except FileNotFoundError:
            raise Problem("conflict", "The mesh that this step starts from was deleted.") from None
        fields: Mapping[str, StepField] = {}
        if mesh_input.fields is not None:
            with files.local(mesh_input.fields) as path:
                fields = read_fields(path)
        settings = mesh_input.settings or {}
        motion = {name: settings[name] for name in MOTION if name in settings}
        return cls(mesh=mesh, fields=fields, earlier=_earlier(settings.get("before"), spec, files), motion=motion)

    def take(self, spec: BuiltSpec, options: SolveArguments) -> AnySequenceStep:
        """The step to the problem of ``spec``; raises :class:`~equimesh.errors.InputError` where it is refused."""
        fields = {name: field.mesh_values() for name, field in self.fields.items()}
        if isinstance(spec.problem, BlockProblem):
            if isinstance(self.mesh, equimesh.Mesh):
                raise TypeError("a step on blocks follows a mesh of blocks")
            on_blocks = equimesh.BlockSequence(
                spec.problem, mesh=self.mesh, solution=self.earlier, **self.motion, **options
            )
            return on_blocks.step(spec.problem.monitor, fields)
        if isinstance(self.mesh, QuadMesh):
            raise TypeError("a step on a grid follows a mesh of a grid")
        settings: SolveArguments = {**options, "mode": spec.mode, "allow_relaxed": spec.allow_relaxed}
        sequence = equimesh.Sequence(
            spec.problem,
            spec.grid_schwarz,
            mesh=self.mesh,
            solution=self.earlier,
            **self.motion,
            **settings,
        )
        return sequence.step(spec.problem.monitor, fields)

    def arrived(self, data: equimesh.MeshData, step: AnySequenceStep) -> equimesh.MeshData:
        """The data of the new mesh with its displacement, the fields carried to it, and the JSON of the step."""
        name = next((name for name in VELOCITIES if name not in self.fields), None)
        at_nodes = {key: values for key, values in step.fields.items() if self.fields[key].location == "nodes"}
        in_cells = {key: values for key, values in step.fields.items() if key not in at_nodes}
        moved = {} if name is None or step.velocity is None else {name: step.velocity}
        return replace(
            data,
            fields={**at_nodes, **moved},
            cell_fields=in_cells,
            step=json.dumps(self._answer(step, name if moved else None), allow_nan=False),
        )

    def _answer(self, step: AnySequenceStep, velocity: str | None) -> dict[str, Any]:
        """What the step says of itself, with the name of its displacement, and how its fields came."""
        certificate = certificate_of(step)
        fields = {
            name: {"transfer": field.transfer, "location": field.location, "bounds": field.bounds}
            for name, field in self.fields.items()
        }
        said = {"status": SUCCEEDED, "certificate": certificate, "warnings": certificate["warnings"]}
        return {**said, **moves_of(step), "velocity": velocity, "fields": fields}


def certificate_of(step: AnySequenceStep) -> dict[str, Any]:
    """The certificate of the mesh of a step, whose warnings include those of the step."""
    return {**step.certificate.summary(), "warnings": list(step.warnings)}


def moves_of(step: AnySequenceStep) -> dict[str, Any]:
    """The number of substeps, and how far the nodes moved, in cells."""
    return {"substeps": step.substeps, "moved": step.moved}


def _earlier(before: Mapping[str, Any] | None, spec: BuiltSpec, files: Files) -> equimesh.Earlier | None:
    """The source and the gains of the mesh before; None for steps of earlier releases."""
    if before is None:
        return None
    norm = getattr(spec.problem.monitor, "norm", "l2")
    gain = before["gains"].get(norm)
    return equimesh.Earlier(u=_u_of(before, spec, files), gain=math.nan if gain is None else float(gain))


def _u_of(before: Mapping[str, Any], spec: BuiltSpec, files: Files) -> equimesh.Field | None:
    """The u of the mesh before; None where it has none, or where its samples are gone."""
    source = before["u"]
    if source is None:
        return None

    def find(_name: str, box: Any) -> equimesh.Field:
        with files.local(before["samples"]) as path:
            return field_of(path, box)

    try:
        return build_field(source, spec.problem.domain, find, "u")
    except (FileNotFoundError, InputError):
        return None
