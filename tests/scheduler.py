"""The order in which several processes of tests take their work."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

TESTS = Path(__file__).parent
# Folders whose tests share a service, a browser or a cluster of the session, and how many processes at most start one;
# those that take longest come first.
SHARED = {"service": 2, "browser": 1, "cluster_package": 1, "fuzz": 1, "client": 1}
# Files that take long, most of them by waiting: begun early, so that no single one is waited for at the end.
LONG = (
    *("test_durability", "test_replicas", "test_deployment", "test_faults", "test_backup", "test_base_install"),
    *("test_jobs_survive", "test_parts_over_http", "test_consumers", "test_benchmarks", "test_structure"),
)
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

    def _assign_work_unit(self, node: WorkerController) -> None:
        """Give a process its next tests; while all others wait for services or browsers, it gets some that compute."""
        others = [units for other, units in self.assigned_work.items() if other is not node]
        if others and all(map(are_waiting, others)):
            computing = next((unit for unit in self.workqueue if not waits(unit)), None)
            if computing is not None:
                self.workqueue.move_to_end(computing, last=False)
        super()._assign_work_unit(node)


def waits(unit: str) -> bool:
    """Whether the tests of a unit wait most of the time: for a service, a browser, or processes of their own."""
    return ", part " in unit or unit.rpartition("/")[2].startswith(LONG)


def are_waiting(units: dict[str, dict[str, bool]]) -> bool:
    """Whether a process has tests that wait among those of its units that are not done yet."""
    return any(waits(unit) and not all(done.values()) for unit, done in units.items())


def unit_of(nodeid: str) -> str:
    """What one process takes at a time: a file, files that share a service, or one test."""
    file = nodeid.partition("::")[0]
    if file in LOOSE:
        return "::".join(nodeid.split("::")[:2])
    folder = file.split("/")[1]
    if file in ONE_PROCESS:
        return "tests/service, part 0"
    if folder in SHARED:
        return f"tests/{folder}, part {parts_of(folder).get(file, 0)}"
    return file


@cache
def parts_of(folder: str) -> dict[str, int]:
    """The part of each file of a shared folder: each in turn, the longest first, joins the shortest part."""
    paths = sorted((TESTS / folder).rglob("test_*.py"), key=lambda path: path.stat().st_size, reverse=True)
    parts, lengths = dict[str, int](), [0] * SHARED[folder]
    if folder == "service":
        lengths[0] = sum((TESTS.parent / file).stat().st_size for file in ONE_PROCESS)
    for path in paths:
        file = f"tests/{path.relative_to(TESTS).as_posix()}"
        if file not in ONE_PROCESS:
            parts[file] = lengths.index(min(lengths))
            lengths[parts[file]] += path.stat().st_size
    return parts
