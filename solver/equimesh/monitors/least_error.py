"""The request for a mesh that minimises the interpolation error of u, in place of a metric."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from equimesh.errors import InputError
from equimesh.fields.expression import Field, require_fields
from equimesh.monitors.curvature import NORMS, Curvature
from equimesh.monitors.monitor import Monitor, require_orthogonality, weaken
from equimesh.monitors.probe import AnyDomain, Probe, bound_copy, is_bound_to
from equimesh.numerics.types import Array

CELLS = ("quad", "triangle")
"""The cells on which the error is measured."""
MAX_WEIGHT = 1e3
"""The largest ``distortion`` and ``smoothness``."""
PROBED_CELLS = 64
"""Points a direction at which u is checked before a solve."""
MAX_SIZE, MIN_SIZE = 1e140, 1e-140
"""The largest and smallest size of u: squares of its errors are numbers between them."""


@dataclass(frozen=True, kw_only=True)
class LeastError:
    """The nodes where the error of interpolating u is least, in place of equal lengths in a metric.

    ``norm`` is that of the error: ``"l2"`` of u, ``"h1"`` of its gradient. ``distortion`` and ``smoothness`` weigh how
    far cells may be deformed, and how unevenly neighbours: lower them for a smaller error, raise them for cells
    nearer to squares. ``cells`` are those of the file: on ``"triangle"`` the error is that of linear interpolation on
    the triangles into which :meth:`~equimesh.meshes.mesh_data.MeshData.triangles` cuts the mesh.

    A :class:`~equimesh.monitors.monitor.Monitor`, whose metric only serves the measures of quality: that of
    :class:`~equimesh.monitors.curvature.Curvature`, in which the mesh would be equidistributed if the error were that
    of its leading order. Raises :class:`~equimesh.errors.InputError` for values outside these ranges.
    """

    u: Field
    norm: Literal["l2", "h1"] = "l2"
    distortion: float = 0.5
    smoothness: float = 1.0
    cells: Literal["quad", "triangle"] = "quad"
    rectilinear: bool = False
    """Whether lines stay straight: x depends on xi alone, y on eta alone. On a mapped domain they are lines of the
    reference square. Every face is then orthogonal on a rectangle."""
    orthogonality: float | None = None
    """The largest angle of non-orthogonality of the mesh, in degrees; ``None`` for no bound."""
    _domain: AnyDomain | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_fields(self, "u")
        require_orthogonality(self.orthogonality)
        for name, known in (("norm", NORMS), ("cells", CELLS)):
            if getattr(self, name) not in known:
                raise InputError(f"{name} = {getattr(self, name)!r}: choose {known[0]!r} or {known[1]!r}", field=name)
        if not isinstance(self.rectilinear, bool):
            raise InputError(f"rectilinear = {str(self.rectilinear)[:20]}: give True or False", field="rectilinear")
        for name in ("distortion", "smoothness"):
            value = getattr(self, name)
            if not (isinstance(value, int | float) and 0.0 < value <= MAX_WEIGHT and math.isfinite(value)):
                raise InputError(
                    f"{name} = {value}: the weight must be positive and at most {MAX_WEIGHT:g}; 1 is usual", field=name
                )

    def metric(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """``(m11, m12, m22)`` of the curvature of u at physical points.

        Raises :class:`~equimesh.errors.InputError` before the monitor is bound to a domain.
        """
        return self._curvature.metric(x, y)

    def on(self, domain: AnyDomain) -> LeastError:
        """The monitor bound to ``domain``.

        Raises :class:`~equimesh.errors.InputError` at a point of the domain where u or a derivative that the norm needs
        is not finite, and where u is so large or small that the squares of its errors are no numbers.
        """
        if is_bound_to(self._domain, domain):
            return self
        probe = Probe.of(domain, PROBED_CELLS)
        values = self.u.evaluate(probe.x, probe.y, order=1 if self.norm == "l2" else 2)
        probe.require_finite(values, "u or its derivatives are", field="u")
        size = float(np.abs(values[0]).max())
        if size > MAX_SIZE or 0.0 < size < MIN_SIZE:
            raise InputError(
                f"u has the size {size:.3g}: squares of its errors are no numbers; multiply u by a constant, which does"
                " not change the mesh",
                field="u",
            )
        return bound_copy(self, domain)

    def weakened(self, strength: float) -> Monitor:
        """The metric to the matrix power ``strength``."""
        return weaken(self, strength)

    @cached_property
    def _curvature(self) -> Curvature:
        if self._domain is None:
            raise InputError("the metric of a least-error monitor depends on the domain: call monitor.on(domain) first")
        return Curvature(u=self.u, norm=self.norm).on(self._domain)
