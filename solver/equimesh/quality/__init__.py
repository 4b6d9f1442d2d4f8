"""How good a mesh is: measures of its cells, and how well it interpolates u."""

from equimesh.quality.measures import (
    Measure,
    Quality,
    alignment,
    equidistribution,
    measure,
    shape_regularity,
)

__all__ = ["Measure", "Quality", "alignment", "equidistribution", "measure", "shape_regularity"]
