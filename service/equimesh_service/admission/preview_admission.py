"""The checks of a request for a preview, which stores nothing."""

from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, ClassVar

from equimesh.specs.spec import BuiltSpec
from equimesh_service.admission.admit import Admission, Admitted
from equimesh_service.admission.callers import Caller
from equimesh_service.assembly import samples as intake
from equimesh_service.assembly.long_spec import ShortSpec
from equimesh_service.assembly.samples import Upload
from equimesh_service.files.port import StoredFile
from equimesh_service.spec.mesh import CheckedSpec
from equimesh_service.store.rows import SamplesRow


@dataclass(frozen=True)
class PreviewAdmission(Admission):
    """Checks one request for a preview. ``sent`` gets the samples that came with it, as npz files by their ids.

    A monitor that takes long to check is checked by the worker that solves.
    """

    product: ClassVar[str] = "a preview"
    sent: dict[str, bytes] = field(default_factory=dict)

    @classmethod
    def of(cls, admission: Admission) -> "PreviewAdmission":
        """The checks with the limits of previews."""
        settings = admission.settings
        most = min(settings.max_points, settings.max_preview_points)
        limits = settings.model_copy(update={"max_points": most, "max_cluster_points": 0})
        return cls(
            settings=limits,
            store=admission.store,
            files=admission.files,
            side_workers=admission.side_workers,
            while_waiting=admission.while_waiting,
        )

    @property
    def _way_to_more(self) -> str:
        return "; request the mesh itself (POST /v1/meshes), which may have more"

    def _admit(self, short: ShortSpec, upload: Upload | None, caller: Caller, mesh: Upload | None = None) -> Admitted:
        return super()._admit(replace(short, spec=short.spec.whole()), upload, caller, mesh)

    def _check(self, spec: CheckedSpec, rows: Any, sent: Any) -> tuple[BuiltSpec | None, bytes | None]:
        return super()._check(spec, rows, sent) if spec.is_quick else (None, None)

    def _keep(self, path: Path, summary: dict[str, Any], caller: Caller, *, durable: bool) -> tuple[SamplesRow, bool]:  # noqa: ARG002
        content = path.read_bytes()
        row = intake.row_of(StoredFile(sha256(content).hexdigest(), len(content)), summary, self.store.clock())
        self.sent[row.id] = content
        return row, True
