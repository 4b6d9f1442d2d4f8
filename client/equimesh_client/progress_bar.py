"""The progress bar."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self

from tqdm import tqdm

from equimesh_client.records.resources import progress_of

# The form of the bar, and that where nobody knows how much work is ahead.
KNOWN = "{percentage:3.0f}% |{bar:10}| {elapsed} {desc}"
UNKNOWN = "{elapsed} {desc}"
# The width of a line where the terminal does not tell its own, and that of the bar before the words.
COLUMNS = 80
BAR_COLUMNS = 26


class Bar:
    """One line on standard error: the done percentage where it is known, and what is being done; a context manager.

    ``shown``: True shows it, False does not, None only when standard error is a terminal. A line that ``stays`` is not
    removed at the end.
    """

    def __init__(self, shown: bool | None, *, stays: bool = False) -> None:
        disable = None if shown is None else not shown
        self._line = tqdm(total=100.0, bar_format=UNKNOWN, disable=disable, leave=stays, dynamic_ncols=True)
        self.shown = not self._line.disable

    def show(self, fraction: float | None, words: str) -> None:
        """Show the done part of the work, 0 to 1, which never falls, and what is being done."""
        if not self.shown:
            return
        self._line.bar_format = UNKNOWN if fraction is None else KNOWN
        self._line.n = max(self._line.n, 100.0 * (fraction or 0.0))
        width = (self._line.ncols or COLUMNS) - BAR_COLUMNS
        self._line.set_description_str(words if len(words) <= width else f"{words[: width - 1]}…", refresh=False)
        self._line.refresh()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._line.close()


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
