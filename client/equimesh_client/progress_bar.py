"""The progress bar."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tqdm import tqdm

from equimesh_client.records.state import progress_of

FORM = "{desc} {percentage:3.0f}%|{bar}| {elapsed}{postfix}"


class Watch:
    """Shows the progress of a mesh on standard error while it is waited for; a context manager.

    ``progress``: True shows a bar, False none, None only when standard error is a terminal.
    """

    def __init__(self, progress: bool | None) -> None:
        disable = None if progress is None else not progress
        self._bar = tqdm(total=100.0, bar_format=FORM, disable=disable, leave=True, desc="waiting")
        self.shown = not self._bar.disable

    def update(self, record: Mapping[str, Any]) -> None:
        """Show the state of a mesh resource."""
        if not self.shown:
            return
        progress = progress_of(record)
        words = []
        if progress.iteration is not None:
            words.append(f"{'iteration' if progress.gain is None else 'step'} {progress.iteration}")
        if progress.residual is not None:
            words.append(f"residual {progress.residual:.1e}")
        if progress.gain is not None:
            words.append(f"error {progress.gain:.1f} times smaller")
        self._bar.set_description_str(progress.stage or str(record.get("status", "")), refresh=False)
        self._bar.set_postfix_str(", ".join(words), refresh=False)
        self._bar.update(max(0.0, 100.0 * progress.fraction - self._bar.n))
        self._bar.refresh()

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()
