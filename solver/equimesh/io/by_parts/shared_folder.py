"""Whether a folder is one that all processes reach: a worker writes a file, and the caller looks for it."""

import os
import socket
import time
from pathlib import Path

from equimesh.errors import InputError

# How long the caller waits for the file of a worker: network folders show new files late.
WAIT_SECONDS = 5.0
# How often it looks.
LOOK_SECONDS = 0.05


def leave_probe(path: str | os.PathLike[str], token: str) -> str:
    """Write a small file next to ``path``, named by ``token``; returns the name of this machine. Runs on a worker.

    Raises :class:`~equimesh.errors.InputError` where this machine has no such folder, or may not write there.
    """
    machine, probe = socket.gethostname(), _probe(Path(path), token)
    try:
        probe.write_text(machine)
    except OSError as error:
        raise InputError(
            f"the worker on {machine} cannot write to {probe.parent}: {error.strerror or error}. Give a folder that all"
            " workers reach, such as a network folder with the same name everywhere",
            field="path",
        ) from error
    return machine


def require_probe(path: str | os.PathLike[str], token: str, machine: str, *, seconds: float = WAIT_SECONDS) -> None:
    """Return when the file that a worker on ``machine`` left with ``token`` is here too, and remove it.

    Runs in the process that writes the head. Raises :class:`~equimesh.errors.InputError` where it does not appear
    within ``seconds``: the worker wrote to another folder of the same name, which is on its own machine.
    """
    probe, end = _probe(Path(path), token), time.monotonic() + seconds
    while not _is_there(probe):
        if time.monotonic() >= end:
            raise InputError(
                f"what the worker on {machine} wrote to {probe.parent} is not seen on {socket.gethostname()}: the"
                " folder is on its own machine. Give a folder that all workers and the caller reach",
                field="path",
            )
        time.sleep(LOOK_SECONDS)
    probe.unlink(missing_ok=True)


def _is_there(probe: Path) -> bool:
    """Whether the file exists; the folder is listed first, which makes network folders look again."""
    try:
        return probe.name in os.listdir(probe.parent)
    except OSError:
        return False


def _probe(path: Path, token: str) -> Path:
    return path.parent / f".equimesh-{token}.probe"
