"""A drawing: one npz with all that a page needs to draw a mesh, next to the uniform mesh of its size."""

import io
import json
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from equimesh import Decomposition, Grid, Schwarz
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
    """Coordinates in double precision; what is only coloured in single precision."""
    arrays: Arrays = {"x": compared.mesh.x, "y": compared.mesh.y, "q_eq": _single(compared.q_eq)}
    if compared.u is not None and compared.error is not None:
        arrays |= {"u": _single(compared.u), "error": _single(compared.error)}
    return {prefix + name: values for name, values in arrays.items()}


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
    grid: Grid,
) -> dict[str, Any]:
    """What a drawing says of its mesh in numbers and sentences.

    ``result`` has the record of the solve, the certificate and the quality, as a mesh in the store has them; ``error``
    is the problem of a failed solve.
    """
    decomposition = None if schwarz is None else schwarz.decompose(grid)
    return {
        "spec": dict(spec),
        "status": SUCCEEDED if error is None else FAILED,
        "solution": result["solution"],
        "certificate": result["certificate"],
        "quality": result["quality"],
        "convergence": convergence,
        "error": error,
        "sentences": sentences_of(result["certificate"], norm_of(spec), error),
        "subdomains": None if decomposition is None else _spans(decomposition),
        "ordering": None if schwarz is None else str(schwarz.ordering),
        "frames": None,
    }


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
