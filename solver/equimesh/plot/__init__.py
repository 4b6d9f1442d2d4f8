"""Pictures of meshes and of convergence."""

from equimesh.plot.convergence import draw_convergence, draw_histories
from equimesh.plot.figure import COLOURS, MARKERS, figure_file, iteration_axis, semilog
from equimesh.plot.meshes import (
    SINGLE_COLOUR,
    draw_comparison,
    draw_decomposition,
    draw_mesh,
    draw_quality,
    draw_surface,
)

__all__ = [
    "COLOURS",
    "MARKERS",
    "SINGLE_COLOUR",
    "draw_comparison",
    "draw_convergence",
    "draw_decomposition",
    "draw_histories",
    "draw_mesh",
    "draw_quality",
    "draw_surface",
    "figure_file",
    "iteration_axis",
    "semilog",
]
