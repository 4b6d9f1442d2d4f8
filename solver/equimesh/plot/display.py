"""How meshes show themselves: in a notebook, and on axes of the reader's own.

Needs matplotlib for pictures: ``pip install 'equimesh[plot]'``. A notebook shows the table alone without it.
"""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from equimesh.errors import InputError
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array
from equimesh.plot.figure import drawing
from equimesh.plot.meshes import colours_of, draw_cells
from equimesh.quality.comparison import ComparedMesh

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIDE = 3.2
"""Inches of the longer side of the picture in a notebook."""
RESOLUTIONS = (150, 100, 70, 45)
"""Dots per inch of that picture: the first whose file is small enough."""
MAX_BYTES = 70_000
"""Bytes of the picture, in base64 a third more."""
MAX_WARNINGS = 3
"""Warnings below the table."""


def draw_on(mesh: Mesh | QuadMesh, error: Array | None, axes: Axes | None = None) -> Axes:
    """Draw a mesh on ``axes``, every cell with the colour of its ``error``, and return the axes.

    Without ``axes`` those of pyplot are taken. The colours are even in the logarithm; ``error`` has the ``cell_shape``
    of the mesh, and is ``None`` where there is none. Raises ``ImportError`` without matplotlib, and
    :class:`equimesh.InputError` for what is no axes, such as the name of a file.
    """
    if axes is None:
        try:
            import matplotlib.pyplot as plt
        except ImportError as missing:
            raise ImportError("drawing needs matplotlib: pip install 'equimesh[plot]'") from missing
        axes = plt.gca()
    elif not hasattr(axes, "pcolormesh"):
        remedy = "give axes of matplotlib, or save the picture with .plot().figure.savefig('mesh.png')"
        raise InputError(f"axes = {axes!r:.40}: {remedy}", field="axes")
    scale = colours_of([] if error is None else [error])
    draw_cells(axes, mesh, error, scale)
    axes.set_aspect("equal")
    axes.autoscale_view()
    return axes


def html_of(title: str, facts: Mapping[str, str], warnings: Iterable[str], compared: ComparedMesh) -> str:
    """A picture of the mesh beside a table of ``facts``, for a notebook in light or dark colours; below 100 KB."""
    rows = "".join(
        f'<tr><th style="text-align:left">{_text(name)}</th><td style="text-align:left">{_text(text)}</td></tr>'
        for name, text in facts.items()
    )
    several = list(warnings)
    told = [_text(one) for one in several[:MAX_WARNINGS]]
    if len(several) > MAX_WARNINGS:
        told.append(f"{len(several) - MAX_WARNINGS} more warnings are in the certificate.")
    remarks = "".join(f'<p style="max-width:60ch;margin:0.4em 0 0 0">{one}</p>' for one in told)
    try:
        source = base64.b64encode(_picture(compared)).decode()
        picture = (
            f'<img alt="the mesh, coloured by its error" style="max-width:20em" src="data:image/png;base64,{source}">'
        )
    except ImportError:
        picture = ""
    words = f"<strong>{_text(title)}</strong><table>{rows}</table>{remarks}"
    return (
        '<div style="display:flex;flex-wrap:wrap;gap:1.5em;align-items:flex-start">'
        f'{picture}<div style="flex:1 1 20em;min-width:0">{words}</div></div>'
    )


def _text(words: str) -> str:
    return html.escape(words, quote=False)


def _picture(compared: ComparedMesh) -> bytes:
    """A PNG without a background."""
    x, y = compared.mesh.x, compared.mesh.y
    width, height = float(x.max() - x.min()), float(y.max() - y.min())
    size = SIDE / max(width, height)
    with drawing(max(size * width, 0.4), max(size * height, 0.4)) as figure:
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        draw_on(compared.mesh, compared.error, axes)
        axes.set_axis_off()
        for resolution in RESOLUTIONS:
            file = io.BytesIO()
            figure.savefig(file, format="png", dpi=resolution, transparent=True)
            if file.tell() <= MAX_BYTES:
                break
    return file.getvalue()
