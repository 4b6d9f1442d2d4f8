"""From a document to a problem: plain mappings in the JSON form of the HTTP interface, and files that hold them."""

from equimesh.specs.domains import FindMesh, build_domain, count_points, meshes_in, no_meshes
from equimesh.specs.schwarz import build_schwarz
from equimesh.specs.sources import FindSamples, build_expression, build_field, no_samples, samples_in
from equimesh.specs.spec import BuiltSpec, build, load

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
]
