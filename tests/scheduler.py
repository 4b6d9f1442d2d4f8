"""The order in which several processes of tests take their work."""

from __future__ import annotations

from zlib import crc32

from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

# Folders whose tests share a service or a browser of the session, and how many processes at most start one.
SHARED = {"browser": 2, "client": 1, "fuzz": 1, "service": 2}
# Files of other folders that share the service as a process with those of tests/service/telemetry.
OBSERVED = ("tests/proofs/test_hostile.py",)
# Files whose tests share nothing: each test is given out by itself.
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
    """What one process takes at a time: a file, a part of a folder whose files share a service, or one test."""
    file = nodeid.partition("::")[0]
    if file in LOOSE:
        return nodeid
    folder = file.split("/")[1]
    if file in OBSERVED or file.startswith("tests/service/telemetry/"):
        return "tests/service, part 0"
    if folder in SHARED:
        return f"tests/{folder}, part {crc32(file.encode()) % SHARED[folder]}"
    return file
