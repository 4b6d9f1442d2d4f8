"""Files that would take far more memory or time than their bytes: what their refusal may cost."""

from __future__ import annotations

import re
import sys
import time
from pathlib import Path

import pytest

from equimesh.errors import SamplesError
from equimesh.upload.samples import read_arrays

# Also how large an upload may be, and how much may come out of it.
MAX_BYTES = 8_000_000
MAX_PEAK_BYTES = 15_000_000
# Of processor time; some 20 times what the slowest refusal takes on an idle machine.
MAX_SECONDS = 10.0


def check_bomb_is_refused(data: bytes, filename: str, match: str) -> None:
    """The file is refused with a message that matches, within bounds of memory and time."""
    assert len(data) <= MAX_BYTES
    _peak()  # from here on
    before, began = _peak(), time.process_time()
    with pytest.raises(SamplesError, match=match):
        read_arrays(data, filename, max_bytes=MAX_BYTES)
    assert time.process_time() - began < MAX_SECONDS
    assert _peak() - before < MAX_PEAK_BYTES


def _peak() -> int:
    """Most bytes that this process held since the last call; 0 where the system does not report them."""
    if sys.platform != "linux":
        return 0
    found = re.search(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text())
    Path("/proc/self/clear_refs").write_text("5")
    return int(found[1]) * 1024
