"""The progress bar: one line of a terminal, a bar in a notebook, and nothing elsewhere."""

from __future__ import annotations

import sys
import time
import warnings
from typing import Any, Self

from tqdm import tqdm

# The form of the bar, and that where nobody knows how much work is ahead.
KNOWN = "{percentage:3.0f}% |{bar:10}| {elapsed} {desc}"
KNOWN_IN_NOTEBOOK = "{percentage:3.0f}% {bar} {elapsed} {desc}"
UNKNOWN = "{elapsed} {desc}"
# The width of a line where the terminal does not tell its own, and that of the bar before the words.
COLUMNS = 80
BAR_COLUMNS = 26
DELAY = 0.5
"""Seconds of a solve without a bar: most small meshes take less."""


def in_notebook() -> bool:
    """Whether this process is the kernel of a notebook."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return getattr(shell, "kernel", None) is not None


def _line_class() -> Any:
    """The class of the line: with widgets in a notebook that has them, else plain text."""
    if not in_notebook():
        return tqdm
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that ipywidgets is missing: plain text is right, too
        from tqdm.auto import tqdm as found
    return found


class Bar:
    """One line on standard error: the done percentage where it is known, and what is being done; a context manager.

    ``shown``: True shows it, False does not, None only in a notebook, and where standard error is a terminal. A line
    that ``stays`` is not removed at the end. Nothing is shown in the first ``delay`` seconds.
    """

    def __init__(self, shown: bool | None, *, stays: bool = False, delay: float = 0.0) -> None:
        line = _line_class()
        disable = (False if in_notebook() else None) if shown is None else not shown
        self._line = line(
            total=100.0, bar_format=UNKNOWN, disable=disable, leave=stays, dynamic_ncols=True, delay=delay
        )
        self._known = KNOWN if line is tqdm else KNOWN_IN_NOTEBOOK
        self._begin = time.monotonic() + delay
        self.shown = not self._line.disable

    def show(self, fraction: float | None, words: str) -> None:
        """Show the done part of the work, 0 to 1, which never falls, and what is being done."""
        if not self.shown or time.monotonic() < self._begin:
            return
        self._line.bar_format = UNKNOWN if fraction is None else self._known
        self._line.n = max(self._line.n, 100.0 * (fraction or 0.0))
        # A notebook has no columns: it breaks lines itself.
        columns = self._line.ncols if isinstance(self._line.ncols, int) else COLUMNS
        width = columns - BAR_COLUMNS
        self._line.set_description_str(words if len(words) <= width else f"{words[: width - 1]}…", refresh=False)
        self._line.last_print_t = self._line._time()  # or close() would leave the line of a bar with a delay
        self._line.refresh()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, failure: object, *_: object) -> None:
        if failure is None and not self._line.disable:
            self._line.n = self._line.total  # a notebook leaves a red line of less
        self._line.close()

    def __del__(self) -> None:
        if hasattr(self, "_line"):
            self.__exit__(None)


class ProgressBar(Bar):
    """An observer of a solve or of rounds that shows each step in a bar: ``observe=ProgressBar()``.

    ``shown``: True shows it, False does not, None only in a notebook and on a terminal. ``share`` is the part of the
    bar that the solve fills. As a context manager it takes its line away at once.
    """

    def __init__(self, shown: bool | None = None, *, share: float = 1.0, delay: float = DELAY) -> None:
        super().__init__(shown, delay=delay)
        self._share = share

    def __call__(self, event: Any) -> None:
        """Show a record of a solve, which has ``fraction`` and ``phase``, or one of a round of adapting."""
        if not self.shown:
            return
        if hasattr(event, "moved_cells"):
            self.show(None, f"round {event.number}, estimated error {event.estimate:.1e}")
            return
        done = None if event.fraction is None else self._share * event.fraction
        self.show(done, f"{event.phase}, {_number(event)}")


def _number(event: Any) -> str:
    """The figure of a record: of an iteration its change, of a descent the error, of a sweep the residual."""
    if hasattr(event, "change"):
        return f"change {event.change:.1e}"
    if hasattr(event, "gain"):
        before = "initial" if event.start == "initial" else "uniform"
        gain = f", {event.gain:.1f} times smaller than on the {before} mesh" if event.gain else ""
        return f"error {event.error:.1e}{gain}"
    return f"residual {event.residual:.1e}"
