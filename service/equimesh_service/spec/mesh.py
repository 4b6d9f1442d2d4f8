"""The spec of a mesh: strict models of the JSON that a client posts, with every default in one place."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat, ValidationInfo, field_validator

from equimesh_schema.document import Parameters
from equimesh_schema.monitors import ArcLength, Auto, LeastError, Monitor, NodalSolution
from equimesh_schema.sources import AnySource, ExpressionSource, GridSource, NodalSource, StoredSource
from equimesh_service.problems.problem import problem_at
from equimesh_service.problems.sentences import WITHOUT_NUL
from equimesh_service.spec.blocks import BlocksSpec, MeshFileSpec
from equimesh_service.spec.domains import Domain, RectangleSpec
from equimesh_service.spec.monitors import sources_of, with_samples
from equimesh_service.spec.schwarz import AnySchwarz, OnBlocks
from equimesh_service.spec.strict import Strict, either, validate

# The most parts that a spec may ask for; how many a grid can have is checked by the solver.
MAX_PARTS = 4096
# The JSON pointer of the mesh that is a domain.
MESH_PLACE = "/domain/file"
MODE_USES = {
    "discretization": "Meshes to compute on: iterates until the error of the solution on the grid is small beside that "
    "of the grid itself.",
    "tight": "Studies that compare meshes digit by digit: solves the equations to rounding.",
}


class GridSpec(Strict):
    """Points of the mesh in each direction; 12 points make 11 cells."""

    n_xi: int = Field(default=64, description="Points along xi, at least 4.")
    n_eta: int = Field(default=64, description="Points along eta, at least 4.")


class TargetSpec(Strict):
    """An interpolation error of u in place of a grid."""

    norm: Literal["l2", "h1"] = Field("l2", description="That of the error of u, or of its gradient.")
    error: FiniteFloat = Field(description="The requested error, positive, in the units of u.")
    max_points: int | None = Field(
        None, description="Most points of the grid, at least 25; null: the limit of the service."
    )


class MeshSpec(Strict):
    """Everything that defines a mesh; all but `monitor` has a default."""

    monitor: Monitor
    domain: Domain = Field(default_factory=RectangleSpec)
    grid: GridSpec | None = Field(
        default_factory=GridSpec,
        description="Absent: 64 x 64, or the grid that a target needs. Blocks have points of their own: null.",
    )
    target: TargetSpec | None = Field(None, description="The error that the grid is to reach, in place of `grid`.")
    boundary: Literal["trace", "equidistributed_1d", "orthogonal"] = Field(
        "trace", description="How points move along the sides; equidistributed_1d is the paper's."
    )
    initial: Literal["nested", "uniform"] = Field(
        "nested", description="The initial mesh: from coarser grids, or uniform as in the paper."
    )
    schwarz: AnySchwarz | None = Field(
        None, description="Absent or null: solved as a single domain. With blocks an iteration between these."
    )
    mode: Literal["discretization", "tight"] = Field(
        "discretization", description="How exactly the discrete equations are solved; see /v1/capabilities."
    )
    allow_relaxed: bool = Field(
        True,
        description="Whether the mesh may be for a weaker monitor where the requested one cannot be solved; its "
        "certificate then says so.",
    )
    cells: Literal["quad", "triangle"] = Field("quad", description="Cells of the mesh file.")
    label: str | None = Field(
        None, max_length=200, pattern=WITHOUT_NUL, description="Free text, for the list of meshes."
    )
    parts: Annotated[
        Literal["auto"] | Annotated[int, Field(ge=1, le=MAX_PARTS)] | None,
        either(f"a whole number from 1 to {MAX_PARTS}, 'auto' or null"),
    ] = Field(
        None,
        description="How many parts of a cluster the mesh is computed in; auto: as many as fit its workers. null: one "
        "machine computes it, or where it is too large for that, a cluster in parts.",
    )

    @field_validator("schwarz", mode="before")
    @classmethod
    def _between_blocks(cls, value: Any, info: ValidationInfo) -> Any:
        """The settings, marked where the domain has blocks."""
        has_blocks = isinstance(info.data.get("domain"), BlocksSpec | MeshFileSpec)
        return OnBlocks(value) if has_blocks and isinstance(value, Mapping) else value


@dataclass(frozen=True)
class CheckedSpec:
    """A spec that fits the models, and the values that admission and store derive from it.

    ``sources`` are the functions of its monitor, by their JSON pointers. ``canonical`` is the same spec
    as plain JSON with every default filled in; posting it gives the same mesh.
    """

    spec: MeshSpec
    sources: Mapping[str, AnySource]
    canonical: Mapping[str, Any]

    @property
    def stored(self) -> dict[str, str]:
        """The ids of stored samples, or "upload", by their JSON pointers; also that of a mesh that is the domain."""
        sources, domain = self.sources.items(), self.spec.domain
        found = {f"{at}/samples": source.samples for at, source in sources if isinstance(source, StoredSource)}
        return {**found, MESH_PLACE: domain.file} if isinstance(domain, MeshFileSpec) else found

    @property
    def has_blocks(self) -> bool:
        """Whether its mesh is one of blocks, which have their own points, in place of a grid."""
        return isinstance(self.spec.domain, BlocksSpec | MeshFileSpec)

    @property
    def is_plain(self) -> bool:
        """Whether its monitor needs no work to fit a domain, or only that of evaluating u at some points."""
        monitor = self.spec.monitor
        if isinstance(monitor, ArcLength):
            return monitor.smoothing == 0.0
        return isinstance(monitor, Auto | LeastError | NodalSolution)

    @property
    def is_quick(self) -> bool:
        """Whether the solver checks it within milliseconds: it evaluates a formula at many points."""
        quick = (ExpressionSource, GridSource, NodalSource)
        return (
            self.is_plain
            and self.spec.target is None
            and not self.has_blocks
            and all(isinstance(source, quick) for source in self.sources.values())
        )

    @cached_property
    def monitor_digest(self) -> str:
        """Equal for specs of the same monitor on the same domain; ids of samples are hashes of their content.

        A target is checked with its monitor, on the boundary and the cells of the spec. So is on blocks what they
        refuse, or take with settings of their own.
        """
        parts = [self.canonical["monitor"], self.canonical["domain"]]
        if self.has_blocks:
            parts += [self.canonical[name] for name in ("grid", "boundary", "parts", "schwarz")]
        if self.spec.target is not None:
            parts += [self.canonical[name] for name in ("target", "boundary", "cells")]
        return _digest(parts)

    @cached_property
    def points_digest(self) -> str:
        """Equal for specs of the same points, which depend on the cells only where the error is measured on them.

        Meshes in different parts have the same points in different files, so their digests differ.
        """
        measured = isinstance(self.spec.monitor, Auto | LeastError)
        other = ["label"] if measured else ["label", "cells"]
        if self.canonical["parts"] is None:  # as in releases without parts
            other.append("parts")
        return _digest({key: value for key, value in self.canonical.items() if key not in other})

    def in_parts(self) -> CheckedSpec:
        """The spec of a mesh that a cluster computes in parts; their number is automatic where it has none."""
        if self.canonical["parts"] is not None:
            return self
        return replace(self, canonical={**self.canonical, "parts": "auto"})

    def whole(self) -> CheckedSpec:
        """The spec of the same points that one machine computes, in no parts."""
        spec = self.spec.model_copy(update={"parts": None})
        return replace(self, spec=spec, canonical={**self.canonical, "parts": None})

    def with_limit(self, max_points: int) -> CheckedSpec:
        """The spec whose target, if it has one, says how many points its grid may have on this service."""
        target = self.canonical["target"]
        if target is None or target["max_points"] is not None:
            return self
        return replace(self, canonical={**self.canonical, "target": {**target, "max_points": max_points}})

    def with_samples(self, name: str, samples_id: str) -> CheckedSpec:
        """The spec that names stored samples in place of those with this name, such as "upload"."""
        monitor = with_samples(self.canonical["monitor"], name, samples_id)
        return replace(self, canonical={**self.canonical, "monitor": monitor})

    def with_mesh(self, mesh_id: str) -> CheckedSpec:
        """The spec whose domain is the stored mesh of this id."""
        domain = self.spec.domain.model_copy(update={"file": mesh_id})
        spec = self.spec.model_copy(update={"domain": domain})
        return replace(self, spec=spec, canonical={**self.canonical, "domain": domain.model_dump(mode="json")})


class ExpressionCheck(Strict):
    """An expression to be checked."""

    expression: str
    parameters: Parameters = Field(default_factory=dict)
    t: FiniteFloat = 0.0
    domain: Domain = Field(default_factory=RectangleSpec, description="Where it is evaluated.")


def read_spec(document: Any) -> CheckedSpec:
    """The spec in a parsed JSON document; raises a 422 problem that lists what is wrong, with pointers."""
    spec = validate(MeshSpec, document)
    if spec.target is not None:
        if document.get("grid") is not None:
            raise problem_at("/target", "a target takes the place of the grid: give one of them")
        spec = spec.model_copy(update={"grid": None})
    elif isinstance(spec.domain, BlocksSpec | MeshFileSpec):
        if document.get("grid") is None:  # one that is given is refused with the reason
            spec = spec.model_copy(update={"grid": None})
    elif spec.grid is None:
        spec = spec.model_copy(update={"grid": GridSpec()})
    return CheckedSpec(spec, dict(sources_of(spec.monitor)), spec.model_dump(mode="json", by_alias=True))


def read_expression_check(document: Any) -> ExpressionCheck:
    """The body of an expression check; raises as :func:`read_spec`."""
    return validate(ExpressionCheck, document)


def _digest(document: Any) -> str:
    return sha256(json.dumps(document, sort_keys=True, allow_nan=False).encode()).hexdigest()
