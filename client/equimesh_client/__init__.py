"""Python client of the equimesh service.

::

    from equimesh_client import Client

    with Client("http://127.0.0.1:8000") as client:
        mesh = client.generate("tanh(20*(x**2 + y**2 - 0.5))", 65)
        print(mesh.quality)
        mesh.download("mesh.vtu")
"""

from typing import NoReturn

from equimesh_client.client import AsyncClient, Client
from equimesh_client.errors import (
    BadArgument,
    Conflict,
    DeadlineExceeded,
    DownloadDamaged,
    EquimeshClientError,
    Forbidden,
    Gone,
    InputProblem,
    InvalidInput,
    MeshCanceled,
    MeshFailed,
    NotFound,
    ProblemError,
    QuotaExceeded,
    RateLimited,
    ServerError,
    ServiceUnreachable,
    StorageFull,
    TooLarge,
    Unauthorized,
)
from equimesh_client.mesh import AsyncMesh, Mesh
from equimesh_client.records.measures import Convergence, Measure, Quality
from equimesh_client.records.resources import Progress, SequenceRecord
from equimesh_client.sequence import AsyncSequence, Sequence
from equimesh_client.spec.domains import Blocks
from equimesh_client.spec.fields import Field, Motion
from equimesh_client.spec.sources import SampleFile, StoredSamples, Upload
from equimesh_client.wire.arrays import MeshArrays, Plot
from equimesh_client.wire.part_downloads import PartArrays
from equimesh_client.wire.settings import RetryPolicy
from equimesh_client.wire.steps import SequenceStep
from equimesh_client.wire.stream import Event
from equimesh_coupling.adaptation import Adaptation, AdaptRound
from equimesh_coupling.errors import BadValues, CouplingError, MissingLibrary, OldLibrary
from equimesh_coupling.goals import Goal, WithAdjoint
from equimesh_coupling.recovery import CellAverages, ErrorIndicator
from equimesh_schema import (
    Aim,
    AnnulusSector,
    Candidate,
    Certificate,
    Classical,
    Estimate,
    FixedRectangle,
    LinearRobin,
    MeshFile,
    NonlinearRobin,
    Optimized,
    Quadrilateral,
    Rectangle,
    Relaxed,
    Schwarz,
    Target,
    monitors,
)
from equimesh_schema.answers import FileOfParts, PartRecord, Parts
from equimesh_schema.monitors import *  # noqa: F403

Relaxation = Relaxed  # the name in release 0.2
Step = SequenceStep  # the name in release 0.2

__all__ = [
    "AdaptRound",
    "Adaptation",
    "Aim",
    "AnnulusSector",
    "AsyncClient",
    "AsyncMesh",
    "AsyncSequence",
    "BadArgument",
    "BadValues",
    "Blocks",
    "Candidate",
    "CellAverages",
    "Certificate",
    "Classical",
    "Client",
    "Conflict",
    "Convergence",
    "CouplingError",
    "DeadlineExceeded",
    "DownloadDamaged",
    "EquimeshClientError",
    "ErrorIndicator",
    "Estimate",
    "Event",
    "Field",
    "FileOfParts",
    "FixedRectangle",
    "Forbidden",
    "Goal",
    "Gone",
    "InputProblem",
    "InvalidInput",
    "LinearRobin",
    "Measure",
    "Mesh",
    "MeshArrays",
    "MeshCanceled",
    "MeshFailed",
    "MeshFile",
    "MissingLibrary",
    "Motion",
    "NonlinearRobin",
    "NotFound",
    "OldLibrary",
    "Optimized",
    "PartArrays",
    "PartRecord",
    "Parts",
    "Plot",
    "ProblemError",
    "Progress",
    "Quadrilateral",
    "Quality",
    "QuotaExceeded",
    "RateLimited",
    "Rectangle",
    "Relaxation",
    "Relaxed",
    "RetryPolicy",
    "SampleFile",
    "Schwarz",
    "Sequence",
    "SequenceRecord",
    "SequenceStep",
    "ServerError",
    "ServiceUnreachable",
    "Step",
    "StorageFull",
    "StoredSamples",
    "Target",
    "TooLarge",
    "Unauthorized",
    "Upload",
    "WithAdjoint",
]
__all__ += monitors.__all__


def __getattr__(name: str) -> NoReturn:
    if name == "BlockSchwarz":
        raise AttributeError("equimesh_client.BlockSchwarz is equimesh_client.Schwarz now, of grids and of blocks")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
