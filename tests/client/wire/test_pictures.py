"""Pictures: their format, and how they are saved and shown."""

from __future__ import annotations

from pathlib import Path

import pytest

from equimesh_client.wire.arrays import Plot, plot_format


@pytest.mark.parametrize(
    ("path", "format", "expected"),
    [(None, None, "svg"), ("a.png", None, "png"), ("a.PNG", "svg", "svg"), ("a", None, "svg"), ("a.gif", None, "gif")],
)
def test_the_format_follows_from_itself_then_the_suffix(path: str | None, format: str | None, expected: str) -> None:
    assert plot_format(path, format) == expected


def test_a_notebook_gets_the_format_that_there_is(tmp_path: Path) -> None:
    svg, png = Plot(data=b"<svg/>", format="svg"), Plot(data=b"\x89PNG", format="png")
    assert (svg._repr_svg_(), svg._repr_png_()) == ("<svg/>", None)
    assert (png._repr_svg_(), png._repr_png_()) == (None, b"\x89PNG")
    assert png.save(tmp_path / "a.png").read_bytes() == b"\x89PNG"
    assert "89PNG" not in repr(png)
