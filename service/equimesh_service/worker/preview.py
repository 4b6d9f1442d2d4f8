"""A preview: one mesh that is solved to be looked at, and not kept."""

import io
import logging
import math
import pickle
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np

import equimesh
from equimesh.specs.spec import BuiltSpec
from equimesh_service.assembly.problem import Samples, check, translate_errors
from equimesh_service.errors import TimeLimitError
from equimesh_service.problems.problem import Problem
from equimesh_service.problems.storage import storage_faults
from equimesh_service.telemetry import log_context
from equimesh_service.worker.drawing import Frames, arrays_of, document_of, pack
from equimesh_service.worker.job import Storage
from equimesh_service.worker.summary import problem_of, summary_of

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Preview:
    """The task of a worker: a canonical spec, and the samples that it names.

    ``stored`` are the SHA-256 of files of samples, and ``sent`` the bytes of those that came with the request, both by
    the ids of the samples. ``built`` is the problem of the spec where it is known, ``packed`` the same as bytes. With
    ``frames`` the drawing has the meshes of a Schwarz iteration. The solve ends itself after ``seconds``, since a
    killed worker is slow to replace.
    """

    spec: Mapping[str, Any]
    storage: Storage
    built: BuiltSpec | None = None
    packed: bytes | None = None
    stored: Mapping[str, str]
    sent: Mapping[str, bytes]
    frames: bool = False
    seconds: float = math.inf
    threads: int = 1
    request_id: str = ""


def draw_preview(preview: Preview) -> bytes:
    """The drawing of a mesh, as the bytes of an npz; nothing is stored.

    Raises a 422 problem for a spec that cannot be solved, a 409 problem when its samples are gone, and
    :class:`~equimesh_service.errors.TimeLimitError`.
    """
    with log_context.enter(log_context.LogContext(request_id=preview.request_id)):
        try:
            with storage_faults():
                return _draw(preview)
        except (Problem, TimeLimitError):
            raise
        except Exception as error:
            _log.error("a preview broke", exc_info=error)  # only the worker knows where
            raise


def _draw(preview: Preview) -> bytes:
    spec = preview.built or _build(preview)
    frames = None
    if preview.frames and spec.schwarz is not None and isinstance(spec.problem, equimesh.Problem):
        frames = Frames(spec.problem.grid.points)
    began = time.perf_counter()

    def observe(event: equimesh.Event) -> None:
        if time.perf_counter() - began > preview.seconds:
            raise TimeLimitError("the time limit was reached")
        if frames is not None:
            frames(event)

    with translate_errors():
        solution = spec.solve(threads=preview.threads, observe=observe, check=False)
    solved = time.perf_counter()
    schwarz, failure = None, None
    if isinstance(solution, equimesh.BlockSolution):
        compared = solution.against_initial
    else:
        compared, schwarz = solution.against_uniform, solution.schwarz
    if not solution.status.succeeded:
        failure = problem_of(solution, is_kept=False).body()
    document = document_of(
        preview.spec,
        {
            "solution": summary_of(solution),
            "certificate": solution.certificate.summary(),
            "quality": None if solution.mesh.is_folded else solution.quality.summary(),
        },
        error=failure,
        convergence=solution.convergence() if schwarz is not None or solution.descent else None,
        schwarz=schwarz,
        mesh=solution.mesh,
    )
    arrays = arrays_of(compared, is_folded=solution.mesh.is_folded)
    document["seconds"] = {"solve": solved - began, "measure": time.perf_counter() - solved}
    if frames is not None:
        arrays |= frames.arrays()
        document["frames"] = frames.numbers
    return pack(document, arrays)


def _build(preview: Preview) -> BuiltSpec:
    if preview.packed is not None:
        packed: BuiltSpec = pickle.loads(preview.packed)
        return packed
    with ExitStack() as stack:
        samples = {name: _arrays(content) for name, content in preview.sent.items()}
        return check(preview.spec, {**samples, **_stored(preview, stack)})


def _stored(preview: Preview, stack: ExitStack) -> dict[str, Samples]:
    if not preview.stored:
        return {}
    files = preview.storage.files()
    try:
        return {name: stack.enter_context(files.local(sha256)) for name, sha256 in preview.stored.items()}
    except FileNotFoundError:
        raise Problem("conflict", "The samples were deleted at this moment; upload them again.") from None


def _arrays(content: bytes) -> Mapping[str, Any]:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return dict(arrays)
