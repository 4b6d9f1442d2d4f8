"""The points of a mesh of blocks, counted before anything is built."""

from collections.abc import Mapping

from equimesh import specs
from equimesh_service.assembly.domain_mesh import MESH
from equimesh_service.assembly.problem import translate_errors
from equimesh_service.problems.problem import problem_at
from equimesh_service.spec.mesh import MESH_PLACE, CheckedSpec
from equimesh_service.store.rows import SamplesRow

_NO_MESH = "these are samples of a function: upload the file of a mesh with POST /v1/samples?kind=mesh"
_NO_SAMPLES = "this is the mesh of a domain, which has no values: upload samples with POST /v1/samples"


def require_kind(row: SamplesRow, pointer: str) -> SamplesRow:
    """The row itself: samples for a function, a mesh for a domain; raises a 422 problem for one of the other."""
    needs_mesh = pointer == MESH_PLACE
    if (row.summary["kind"] == MESH) != needs_mesh:
        raise problem_at(pointer, _NO_MESH if needs_mesh else _NO_SAMPLES)
    return row


def count_points(checked: CheckedSpec, rows: Mapping[str, SamplesRow]) -> tuple[str, int, str]:
    """The JSON pointer of what gives the points of a mesh of blocks, their number, and how to have fewer.

    Raises a 422 problem for a description that is wrong.
    """
    domain = checked.canonical["domain"]
    if "file" in domain:
        return MESH_PLACE, int(rows[domain["file"]].summary["shape"][0]), "take a coarser one"
    with translate_errors():
        return "/domain", specs.count_points(domain), "lower the cells of its blocks, or refine"
