"""From a document to a problem: plain mappings in the JSON form of the HTTP interface, and files that hold them."""

from typing import TYPE_CHECKING, Any

from equimesh_coupling.errors import deferred

if TYPE_CHECKING:
    from equimesh.specs.monitors import FindSamples, build_expression, build_field, no_samples, samples_in
    from equimesh.specs.spec import (
        BuiltSpec,
        FindMesh,
        build,
        build_domain,
        build_schwarz,
        count_points,
        load,
        meshes_in,
        no_meshes,
        subdomains_of,
    )

__all__ = [
    "BuiltSpec",
    "FindMesh",
    "FindSamples",
    "build",
    "build_domain",
    "build_expression",
    "build_field",
    "build_schwarz",
    "count_points",
    "load",
    "meshes_in",
    "no_meshes",
    "no_samples",
    "samples_in",
    "subdomains_of",
]

if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        return deferred(__name__, name)
