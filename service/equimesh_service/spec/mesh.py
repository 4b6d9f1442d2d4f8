"""The spec of a mesh as a client has posted it, and what admission and store derive from it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from typing import Any

from equimesh_schema.document import without_usual
from equimesh_schema.domains import MeshFile
from equimesh_schema.mesh import ExpressionCheck, Grid, MeshSpec, fault_of_points, with_target
from equimesh_schema.monitors import ArcLength, Auto, LeastError, NodalSolution
from equimesh_schema.sources import AnySource, ExpressionSource, GridSource, NodalSource, StoredSource
from equimesh_service.problems.problem import problem_at
from equimesh_service.spec.monitors import sources_of, with_samples
from equimesh_service.spec.strict import to_json, validate

# The JSON pointer of the mesh that is a domain.
MESH_PLACE = "/domain/file"


@dataclass(frozen=True)
class CheckedSpec:
    """A spec that fits the models, and the values that admission and store derive from it.

    ``sources`` are the functions of its monitor, by their JSON pointers. ``canonical`` is the same spec
    as plain JSON with every default filled in; posting it gives the same mesh.
    """

    spec: MeshSpec
    sources: Mapping[str, AnySource]
    canonical: Mapping[str, Any]
    target_pointer: str = "/target"
    """Where its target was sent: a number of points of the grid is one, too."""

    @property
    def stored(self) -> dict[str, str]:
        """The ids of stored samples, or "upload", by their JSON pointers; also that of a mesh that is the domain."""
        sources, domain = self.sources.items(), self.spec.domain
        found = {f"{at}/samples": source.samples for at, source in sources if isinstance(source, StoredSource)}
        return {**found, MESH_PLACE: str(domain.file)} if isinstance(domain, MeshFile) else found

    @property
    def has_blocks(self) -> bool:
        """Whether its mesh is one of blocks, which have their own points, in place of a grid."""
        return self.spec.domain.HAS_BLOCKS

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
        """Equal for specs of the same monitor on the same domain and cells; ids of samples are hashes of their content.

        A target is checked with its monitor, on the boundary of the spec. So is on blocks what they
        refuse, or take with settings of their own.
        """
        parts = [self.canonical[name] for name in ("monitor", "domain", "cells")]
        if self.has_blocks:
            parts += [self.canonical[name] for name in ("grid", "boundary", "parts", "schwarz")]
        if self.spec.target is not None:
            parts += [self.canonical[name] for name in ("target", "boundary")]
        return _digest(parts)

    @cached_property
    def points_digest(self) -> str:
        """Equal for specs of the same points, which depend on the cells only where the error is measured on them.

        Meshes in different parts have the same points in different files, so their digests differ.
        """
        is_round = isinstance(self.spec.monitor, NodalSolution) and self.spec.cells == "triangle"
        measured = isinstance(self.spec.monitor, Auto | LeastError) or is_round
        other = ["label"] if measured else ["label", "cells"]
        if self.canonical["parts"] is None:  # as in releases without parts
            other.append("parts")
        points = {key: value for key, value in self.canonical.items() if key not in other}
        if self.spec.schwarz is not None:  # as in releases without the later keys
            known = without_usual(self.spec.schwarz)
            points["schwarz"] = {key: value for key, value in points["schwarz"].items() if key in known}
        return _digest(points)

    def in_parts(self) -> CheckedSpec:
        """The spec of a mesh that a cluster computes in parts; their number is automatic where it has none."""
        if self.canonical["parts"] is not None:
            return self
        return replace(self, canonical={**self.canonical, "parts": "auto"})

    def whole(self) -> CheckedSpec:
        """The spec of the same points that one machine computes, in no parts."""
        spec = replace(self.spec, parts=None)
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
        domain = {**self.canonical["domain"], "file": mesh_id}
        spec = replace(self.spec, domain=MeshFile(**domain))
        return replace(self, spec=spec, canonical={**self.canonical, "domain": domain})


def read_spec(document: Any) -> CheckedSpec:
    """The spec in a parsed JSON document; raises a 422 problem that lists what is wrong, with pointers."""
    spec, target_pointer = validate(MeshSpec, document), "/target"
    if spec.grid is not None and spec.grid.points is not None:
        fault = fault_of_points(document)
        if fault is not None:
            raise problem_at("/" + fault[0].replace(".", "/"), fault[1])
        document = with_target(document)
        spec, target_pointer = validate(MeshSpec, document), "/grid/points"
    if spec.target is not None:
        if document.get("grid") is not None:
            raise problem_at("/target", "a target takes the place of the grid: give one of them")
        if spec.target.error is None and spec.target.max_points is None:
            raise problem_at("/target/error", "an error is required, or max_points for the least one on so many points")
        spec = replace(spec, grid=None)
    elif spec.domain.HAS_BLOCKS:
        if document.get("grid") is None:  # one that is given is refused with the reason
            spec = replace(spec, grid=None)
    elif spec.grid is None:
        spec = replace(spec, grid=Grid())
    canonical = to_json(spec)
    if canonical["grid"] is not None:  # as in releases without it; a grid that has it became a target
        del canonical["grid"]["points"]
    return CheckedSpec(spec, dict(sources_of(spec.monitor)), canonical, target_pointer)


def read_expression_check(document: Any) -> ExpressionCheck:
    """The body of an expression check; raises as :func:`read_spec`."""
    return validate(ExpressionCheck, document)


def _digest(document: Any) -> str:
    return sha256(json.dumps(document, sort_keys=True, allow_nan=False).encode()).hexdigest()
