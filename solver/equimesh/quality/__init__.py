"""The quality of a mesh: measures of its cells, and the errors of interpolating u."""

from equimesh.quality.cells import Angles, measure_angles
from equimesh.quality.comparison import ComparedMesh, UniformComparison, compare_with_uniform
from equimesh.quality.measures import (
    Measure,
    Quality,
    alignment,
    equidistribution,
    measure,
    measure_each,
    shape_regularity,
)

__all__ = [
    "Angles",
    "ComparedMesh",
    "Measure",
    "Quality",
    "UniformComparison",
    "alignment",
    "compare_with_uniform",
    "equidistribution",
    "measure",
    "measure_angles",
    "measure_each",
    "shape_regularity",
]
