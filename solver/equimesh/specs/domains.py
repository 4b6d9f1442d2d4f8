"""Physical domains and grids of a document."""

from equimesh.domains.curve import Curve
from equimesh.domains.domain import AnnulusSector, Domain, Rectangle
from equimesh.domains.quadrilateral import Quadrilateral
from equimesh.meshes.grid import Grid
from equimesh.specs.document import ByKey, ByKind, Record, as_given, mapping, whole

USUAL_POINTS = 64  # a direction


def _grid(n_xi: int = USUAL_POINTS, n_eta: int = USUAL_POINTS) -> Grid:
    return Grid(n_xi=n_xi, n_eta=n_eta)


GRID = Record(_grid, {"n_xi": whole, "n_eta": whole})
CURVE = ByKey(
    {
        "x": Record(Curve.of_expressions, {"x": as_given, "y": as_given, "parameters": mapping}),
        "points": Record(Curve.through, {"points": as_given}),
    }
)
DOMAIN: ByKind[Domain] = ByKind(
    {
        "rectangle": Record(Rectangle, dict.fromkeys(("x", "y"), as_given)),
        "annulus_sector": Record(AnnulusSector, dict.fromkeys(("center", "radii", "angles"), as_given)),
        "quadrilateral": Record(Quadrilateral, dict.fromkeys(("bottom", "right", "top", "left"), CURVE)),
    },
    default="rectangle",
)


def build_domain(document: object, path: str = "domain") -> Domain:
    """The domain that ``document`` describes, a rectangle where it has no ``kind``.

    Raises :class:`~equimesh.errors.InputError`, whose field begins with ``path``.
    """
    return DOMAIN(document, path)
