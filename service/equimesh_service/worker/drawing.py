"""A drawing: one npz with all that a page needs to draw a mesh, next to the uniform mesh of its size."""

import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from equimesh import Decomposition, Mesh, Schwarz
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.quality import ComparedMesh, UniformComparison
from equimesh_service.store.rows import FAILED, SUCCEEDED
from equimesh_service.worker.sentences import sentences_of

Arrays = dict[str, npt.NDArray[Any]]
# The array with the JSON text.
DOCUMENT = "document"


def arrays_of(compared: UniformComparison, *, is_folded: bool) -> Arrays:
    """The arrays of a mesh and of its uniform mesh; of a folded mesh those of the uniform mesh alone."""
    adapted = {} if is_folded else _arrays_of_mesh(compared.adapted, "")
    return {**adapted, **_arrays_of_mesh(compared.uniform, "uniform_")}


def _arrays_of_mesh(compared: ComparedMesh, prefix: str) -> Arrays:
    """Coordinates in double precision; what is only coloured in single precision.

    Of a mesh of blocks all arrays are flat: block by block, each along j first.
    """
    mesh = compared.mesh
    at_nodes: Arrays = {"x": mesh.x, "y": mesh.y}
    in_cells: Arrays = {"q_eq": _single(compared.q_eq)}
    if compared.u is not None and compared.error is not None:
        at_nodes["u"], in_cells["error"] = _single(compared.u), _single(compared.error)
    if isinstance(mesh, QuadMesh):
        at_nodes = {name: _gathered(values, mesh.blocks) for name, values in at_nodes.items()}
        in_cells = {name: _gathered(values, mesh.block_cells) for name, values in in_cells.items()}
    return {prefix + name: values for name, values in {**at_nodes, **in_cells}.items()}


def _gathered(values: npt.NDArray[Any], places: Sequence[npt.NDArray[np.int64]]) -> npt.NDArray[Any]:
    """The values at the places of all blocks, one block after the other."""
    return np.concatenate([values[block].ravel() for block in places])


def _single(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def document_of(
    spec: Mapping[str, Any],
    result: Mapping[str, Any],
    *,
    error: Mapping[str, Any] | None,
    convergence: Mapping[str, Any] | None,
    schwarz: Schwarz | None,
    mesh: Mesh | QuadMesh,
) -> dict[str, Any]:
    """What a drawing says of its mesh in numbers and sentences.

    ``result`` has the record of the solve, the certificate and the quality, as a mesh in the store has them; ``error``
    is the problem of a failed solve.
    """
    decomposition = None if schwarz is None or isinstance(mesh, QuadMesh) else schwarz.decompose(mesh.grid)
    before: Literal["uniform", "initial"] = "initial" if isinstance(mesh, QuadMesh) else "uniform"
    return {
        "spec": dict(spec),
        "status": SUCCEEDED if error is None else FAILED,
        "solution": result["solution"],
        "certificate": result["certificate"],
        "quality": result["quality"],
        "convergence": convergence,
        "error": error,
        "sentences": sentences_of(result["certificate"], norm_of(spec), error, before=before),
        "subdomains": None if decomposition is None else _spans(decomposition),
        "ordering": None if schwarz is None else str(schwarz.ordering),
        "frames": None,
        "points": int(mesh.x.size),
        "blocks": _blocks_of(mesh) if isinstance(mesh, QuadMesh) else None,
    }


def _blocks_of(mesh: QuadMesh) -> list[dict[str, Any]]:
    """The name of each block, and its points in both directions."""
    return [
        {"name": name, "shape": list(block.shape)} for name, block in zip(mesh.block_names, mesh.blocks, strict=True)
    ]


def norm_of(spec: Mapping[str, Any]) -> str:
    """The norm of the error that a spec wants to be small, ``"l2"`` or ``"h1"``: l2 where it names none."""
    target = spec.get("target")
    return str(target["norm"] if target is not None else spec["monitor"].get("norm") or "l2")


def _spans(decomposition: Decomposition) -> list[dict[str, list[int]]]:
    """The first and the last point of every subdomain along xi and eta."""
    return [
        {name: [span.first, span.last] for name, span in zip(("xi", "eta"), part.spans, strict=True)}
        for part in decomposition.parts
    ]


def pack(document: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> bytes:
    """The bytes of an uncompressed npz with the arrays, and with the JSON text of ``document`` as an array of bytes.

    Equal contents have equal bytes.
    """
    text = np.frombuffer(json.dumps(document, allow_nan=False).encode(), dtype=np.uint8)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, values in {DOCUMENT: text, **arrays}.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, np.ascontiguousarray(values), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), member.getbuffer())
    return file.getvalue()
