"""A drawing: one npz with all that a page needs to draw a mesh, next to the uniform mesh of its size."""

from __future__ import annotations

import io
import json
import time
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

import equimesh
from equimesh import Decomposition, Event, Iteration
from equimesh.meshes.mesh import Mesh
from equimesh.quality import ComparedMesh, UniformComparison
from equimesh.solving.solution import MeasuredMesh
from equimesh.specs import subdomains_of
from equimesh_service.assembly.problem import SamplesOf, build
from equimesh_service.problems.problem import Problem
from equimesh_service.store.rows import FAILED, SUCCEEDED, MeshRow
from equimesh_service.worker.summary import problem_of, sentences_of, summary_of

# The most coordinates x that the frames have in all, and as many y: 8 MiB together in single precision.
MAX_COORDINATES = 1 << 20
# The fewest frames that are kept, however many points a mesh has.
MIN_FRAMES = 8


@dataclass
class Frames:
    """Keeps the meshes of an iteration while it runs: all of them, or every second, fourth, … of a long one.

    ``numbers`` are the numbers of the iterations. The last mesh is always kept. When an iteration begins again, the
    earlier meshes are dropped.
    """

    points: int
    numbers: list[int] = field(default_factory=list)
    _every: int = 1
    _kept: list[npt.NDArray[np.float32]] = field(default_factory=list)
    _last: Iteration | None = None

    def __call__(self, event: Event) -> None:
        """Keep the mesh of an iteration; other events of the solver have none."""
        if not isinstance(event, Iteration):
            return
        if event.iteration == 0:  # another iteration, such as one with a weaker monitor, takes the place of the first
            self.numbers, self._kept, self._every = [], [], 1
        self._last = event
        if event.iteration % self._every:
            return
        self._add(event)
        if len(self.numbers) > self._most:
            self._every *= 2
            kept = [at for at, number in enumerate(self.numbers) if number % self._every == 0]
            self.numbers = [self.numbers[at] for at in kept]
            self._kept = [self._kept[at] for at in kept]

    def arrays(self) -> dict[str, npt.NDArray[np.float32]]:
        """``frames_x`` and ``frames_y`` of shape ``(frames, n_xi, n_eta)``; nothing without an iteration."""
        if self._last is None:
            return {}
        if self.numbers[-1] != self._last.iteration:
            self._add(self._last)
        frames = np.stack(self._kept)
        return {"frames_x": frames[:, 0], "frames_y": frames[:, 1]}

    @property
    def _most(self) -> int:
        return max(MIN_FRAMES, MAX_COORDINATES // self.points)

    def _add(self, event: Iteration) -> None:
        self.numbers.append(event.iteration)
        self._kept.append(np.stack([event.mesh.x, event.mesh.y]).astype(np.float32))


def compare(
    mesh: equimesh.Mesh,
    problem: equimesh.Problem[Any],
    certificate: Mapping[str, Any] | None = None,
) -> UniformComparison:
    """``mesh`` and the uniform mesh of the domain of ``problem``, with the error of u in each of their cells.

    A mesh of blocks is compared with the initial one.

    ``certificate`` is the certificate of the mesh as JSON. It has the monitor that an ``auto`` has chosen: on triangles
    errors are measured only for a least-error mesh.
    """
    monitor = problem.monitor
    if isinstance(monitor, equimesh.Auto) and _chosen(certificate or {}) == "least_error":
        problem = replace(problem, monitor=monitor.least_error())
    measured = MeasuredMesh(problem=problem, mesh=mesh, reference=mesh)
    return measured.against_uniform(mesh, measured.quality().interpolation_error)


def _chosen(certificate: Mapping[str, Any]) -> str:
    """The kind of the monitor that was chosen among several; empty where it was given."""
    return next((str(one["kind"]) for one in certificate.get("comparison") or () if one["chosen"]), "")


Arrays = dict[str, npt.NDArray[Any]]
# The array with the JSON text.
DOCUMENT = "document"


def arrays_of(compared: UniformComparison, *, is_folded: bool) -> Arrays:
    """The arrays of a mesh and of its uniform mesh; for a folded mesh only the arrays of the uniform mesh."""
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
    if not mesh.is_grid:
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
    decomposition: Decomposition | None,
    mesh: Mesh,
) -> dict[str, Any]:
    """The numbers and sentences of a drawing.

    ``result`` has the record of the solve, the certificate and the quality, as a mesh in the store has them; ``error``
    is the problem of a failed solve.
    """
    return {
        "spec": dict(spec),
        "status": SUCCEEDED if error is None else FAILED,
        "solution": result["solution"],
        "certificate": result["certificate"],
        "quality": result["quality"],
        "convergence": convergence,
        "error": error,
        "sentences": sentences_of(result["certificate"], norm_of(spec), error, before=mesh.compared_with),
        "subdomains": None if decomposition is None else _spans(decomposition),
        "ordering": None if decomposition is None else spec["schwarz"]["ordering"],
        "frames": None,
        "points": int(mesh.x.size),
        "blocks": _blocks_of(mesh) if not mesh.is_grid else None,
    }


def _blocks_of(mesh: Mesh) -> list[dict[str, Any]]:
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


def document_of_solution(spec: Mapping[str, Any], solution: equimesh.Solution[Any], seconds: float) -> dict[str, Any]:
    """The document of a solution that is not kept, after a solve of some ``seconds``; ``spec`` is canonical."""
    began = time.perf_counter()
    document = document_of(
        spec,
        {
            "solution": summary_of(solution),
            "certificate": solution.certificate.summary(),
            "quality": None if solution.mesh.is_folded else solution.quality.summary(),
        },
        error=None if solution.status.succeeded else problem_of(solution, is_kept=False).body(),
        convergence=solution.convergence() if solution.iterations or solution.descent else None,
        decomposition=solution.decomposition,
        mesh=solution.mesh,
    )
    document["seconds"] = {"solve": seconds, "measure": time.perf_counter() - began}
    return document


def draw_solution(
    document: dict[str, Any],
    solution: equimesh.Solution[Any],
    frames: Frames | None = None,
) -> bytes:
    """The drawing of a solution that is not kept, with the ``frames`` of its iteration, where there are some."""
    began = time.perf_counter()
    arrays = arrays_of(solution.against_uniform, is_folded=solution.mesh.is_folded)
    document["seconds"]["measure"] += time.perf_counter() - began
    if frames is not None:
        arrays |= frames.arrays()
        document["frames"] = frames.numbers
    return pack(document, arrays)


def draw_mesh_row(
    row: MeshRow,
    spec: Mapping[str, Any],
    convergence: Mapping[str, Any] | None,
    mesh: Mesh,
    find: SamplesOf,
) -> bytes:
    """The drawing of a finished ``mesh`` from its ``row`` in the store, its spec and its history."""
    result = row.result or {}
    parts = subdomains_of(spec)
    document = document_of(spec, result, error=row.error, convergence=convergence, decomposition=parts, mesh=mesh)
    document["seconds"] = result.get("timings")
    problem = _problem(spec, result["certificate"], find)
    compared = MeasuredMesh(problem=problem, mesh=mesh, reference=mesh).against_uniform(mesh, None)
    return pack(document, arrays_of(compared, is_folded=False))


def _problem(spec: Mapping[str, Any], certificate: Mapping[str, Any], find: SamplesOf) -> equimesh.Problem[Any]:
    """The solved problem. Where an ``auto`` monitor has chosen another one, the problem has the chosen one."""
    chosen = next((one for one in certificate.get("comparison", ()) if one["chosen"]), None)
    if spec["monitor"]["kind"] == "auto" and chosen is not None:
        shared = {name: spec["monitor"][name] for name in ("u", "orthogonality") if name in spec["monitor"]}
        monitor = {"kind": chosen["kind"], **shared, **chosen["settings"]}
        try:
            return build({**spec, "monitor": monitor}, find).problem
        except Problem:
            pass  # a candidate that no spec names, such as the uniform mesh
    return build(spec, find).problem
