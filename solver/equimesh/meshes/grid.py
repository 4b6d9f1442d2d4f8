"""The computational domain: a uniform grid of points on the unit square."""

from dataclasses import dataclass

from equimesh.errors import InputError

MIN_POINTS = 4  # in each direction


@dataclass(frozen=True, kw_only=True)
class Grid:
    """``n_xi`` x ``n_eta`` uniformly spaced **points** on the computational unit square.

    A "12 by 12 mesh" of the paper has 12 points a side, hence 11 x 11 cells.

    Raises :class:`~equimesh.errors.InputError` for fewer than 4 points in a direction.
    """

    n_xi: int
    n_eta: int

    def __post_init__(self) -> None:
        for name in ("n_xi", "n_eta"):
            if getattr(self, name) < MIN_POINTS:
                raise InputError(
                    f"{name} = {getattr(self, name)}: a grid needs at least {MIN_POINTS} points in each direction",
                    field=f"grid.{name}",
                )

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of every nodal array, xi first."""
        return (self.n_xi, self.n_eta)

    @property
    def points(self) -> int:
        """Number of grid points."""
        return self.n_xi * self.n_eta

    @property
    def cells(self) -> int:
        """Number of cells."""
        return (self.n_xi - 1) * (self.n_eta - 1)

    @property
    def d_xi(self) -> float:
        """Spacing in xi."""
        return 1.0 / (self.n_xi - 1)

    @property
    def d_eta(self) -> float:
        """Spacing in eta."""
        return 1.0 / (self.n_eta - 1)

    def __str__(self) -> str:
        return f"{self.n_xi} x {self.n_eta}"
