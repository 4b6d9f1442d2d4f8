"""The request to choose the monitor by the measured interpolation error of u."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from equimesh.errors import InputError
from equimesh.fields.expression import Field, require_fields
from equimesh.monitors.curvature import NORMS
from equimesh.monitors.least_error import CELLS, LeastError
from equimesh.monitors.monitor import Monitor, require_orthogonality
from equimesh.monitors.probe import AnyDomain, bound_copy, is_bound_to
from equimesh.numerics.types import Array

PURPOSES = ("finite_volume",)
"""What a mesh can be for, other than to interpolate u."""


@dataclass(frozen=True, kw_only=True)
class Auto:
    """The monitor that :func:`equimesh.solve` chooses: of several, that with the smallest error on a coarse grid.

    ``norm`` is that of the interpolation error of u that is compared: ``"l2"`` of u, ``"h1"`` of its gradient.
    ``cells`` are those of the least-error candidates.

    A :class:`~equimesh.monitors.monitor.Monitor`, whose metric only serves before the choice: that of
    :class:`~equimesh.monitors.least_error.LeastError`. Raises :class:`~equimesh.errors.InputError` for other words.
    """

    u: Field
    norm: Literal["l2", "h1"] = "l2"
    cells: Literal["quad", "triangle"] = "quad"
    purpose: Literal["finite_volume"] | None = None
    """What the mesh is for: ``"finite_volume"`` chooses by the error of a code with cell-centred unknowns.

    The angles have a bound then, 55 degrees if none is given. ``None`` chooses by the interpolation error.
    """
    orthogonality: float | None = None
    """The largest angle of non-orthogonality of the mesh, in degrees; ``None`` for no bound."""
    _least_error: LeastError | None = field(default=None, init=False, repr=False, compare=False)
    _domain: AnyDomain | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_fields(self, "u")
        require_orthogonality(self.orthogonality)
        for name, known in (("norm", NORMS), ("cells", CELLS)):
            if getattr(self, name) not in known:
                raise InputError(f"{name} = {getattr(self, name)!r}: choose {known[0]!r} or {known[1]!r}", field=name)
        if self.purpose not in (None, *PURPOSES):
            raise InputError(
                f"purpose = {self.purpose!r}: choose {PURPOSES[0]!r}, or leave it out for a small interpolation error",
                field="purpose",
            )

    def least_error(
        self, distortion: float = LeastError.distortion, smoothness: float = LeastError.smoothness
    ) -> LeastError:
        """The least-error monitor of the same u, norm and cells."""
        return LeastError(
            u=self.u,
            norm=self.norm,
            distortion=distortion,
            smoothness=smoothness,
            cells=self.cells,
            orthogonality=self.orthogonality,
        )

    def metric(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """``(m11, m12, m22)`` of the curvature of u at physical points.

        Raises :class:`~equimesh.errors.InputError` before the monitor is bound to a domain.
        """
        return self._bound.metric(x, y)

    def on(self, domain: AnyDomain) -> Auto:
        """The monitor bound to ``domain``.

        Raises :class:`~equimesh.errors.InputError` at a point of the domain where u or its gradient is not finite.
        """
        if is_bound_to(self._domain, domain):
            return self
        return bound_copy(self, domain, _least_error=self.least_error().on(domain))

    def weakened(self, strength: float) -> Monitor:
        """The metric to the matrix power ``strength``."""
        return self._bound.weakened(strength)

    @property
    def _bound(self) -> LeastError:
        if self._least_error is None:
            raise InputError("the metric of an auto monitor depends on the domain: call monitor.on(domain) first")
        return self._least_error
