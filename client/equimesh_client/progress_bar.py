"""The progress bar of a mesh at the service."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from equimesh_client.records.resources import progress_of
from equimesh_coupling.progress_bar import Bar


class Watch(Bar):
    """Shows the progress of a mesh on standard error while it is waited for; a context manager."""

    def __init__(self, progress: bool | None) -> None:
        super().__init__(progress, stays=True)

    def update(self, record: Mapping[str, Any]) -> None:
        """Show the state of a mesh resource."""
        if not self.shown:
            return
        progress = progress_of(record)
        words = [progress.phase or progress.stage or str(record.get("status", ""))]
        if progress.residual is not None:
            words.append(f"residual {progress.residual:.1e}")
        if progress.gain is not None:
            words.append(f"error {progress.gain:.1f} times smaller")
        waits = record.get("status") in {"queued", None}
        self.show(None if waits else progress.fraction, ", ".join(words))
