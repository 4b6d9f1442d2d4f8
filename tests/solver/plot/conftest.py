"""Pictures without a layout, which takes half the time of a picture."""

from __future__ import annotations

import pytest


@pytest.fixture
def without_layout(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of texts and colours, which are those of any layout; ``test_figure.py`` has pictures of each kind."""
    figure = pytest.importorskip("matplotlib.figure")
    monkeypatch.setattr(figure.Figure, "set_layout_engine", lambda *_, **__: None)
