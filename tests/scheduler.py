"""The order in which several processes of tests take their work."""

from __future__ import annotations

from zlib import crc32

from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

# Folders whose tests share a service or a browser of the session, and how many processes at most start one.
SHARED = {"browser": 2, "client": 1, "fuzz": 1, "service": 2}
# Files that share the service with keys, or the one that is a process, and files of other folders that use the service
# of the session: one process takes them all, which starts each of these services once.
ONE_PROCESS = tuple(
    f"tests/{name}.py"
    for name in (
        *("service/admission/test_callers", "service/admission/test_quotas", "service/api/test_cursors"),
        *("service/api/test_mesh_parts", "service/api/test_unstored", "service/dispatch/test_turns"),
        *("service/files/test_folder", "service/telemetry/test_logs", "service/telemetry/test_tracing"),
        *("proofs/test_hostile", "proofs/test_ownership", "proofs/test_security", "proofs/test_load"),
        *("cli/checks/test_reach", "cli/commands/test_doctor", "client/test_sequence", "loops/test_adapting"),
    )
)
# Files whose tests share nothing: each test, or class of tests, is given out by itself.
LOOSE = ("tests/examples/test_examples.py",)


class FileScheduling(LoadScopeScheduling):
    """Gives out whole files of tests in the order of the collection, and files that share a service together."""

    def _split_scope(self, nodeid: str) -> str:
        return unit_of(nodeid)

    def _reschedule(self, node: WorkerController) -> None:
        # A process in the place of one that crashed gets its first tests when it has collected them: xdist would give
        # it some before, and end the whole run by an error.
        if node in self.registered_collections:
            super()._reschedule(node)


def unit_of(nodeid: str) -> str:
    """What one process takes at a time: a file, files that share a service, or one test."""
    file = nodeid.partition("::")[0]
    if file in LOOSE:
        return "::".join(nodeid.split("::")[:2])
    folder = file.split("/")[1]
    if file in ONE_PROCESS:
        return "tests/service, part 0"
    if folder in SHARED:
        return f"tests/{folder}, part {crc32(file.encode()) % SHARED[folder]}"
    return file
