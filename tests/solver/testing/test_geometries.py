"""The ten geometries: sizes, areas, nodes that slide."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.testing import check_domain
from equimesh.testing.geometries import DESCRIPTIONS, GEOMETRIES

PROFILE = 0.081706  # the area of NACA 0012 with a closed edge, by the integral of its polynomial
AREAS = {
    "l_shape": 3.0,
    "step": 4.5,
    "obstacle": 7.75,
    "plus": 5.0,
    "ring": 3 * math.pi,
    "disc": math.pi,
    "cylinder": 8.5 * 4 - math.pi / 4,
    "naca0012_o": 16 * math.pi - PROFILE,
    "naca0012_c": 4.5 * math.pi + 24 - PROFILE,
    "pitz_daily": 20.6 * 25.4 + 206 * 50.8 + 84 * 0.5 * (50.8 + 33.2),
}


def test_the_area_of_the_profile() -> None:
    a, b, c, d, e = 1.4845, -0.63, -1.758, 1.4215, -0.518
    assert 2 * 0.12 * (a / 1.5 + b / 2 + c / 3 + d / 4 + e / 5) == pytest.approx(PROFILE, rel=1e-9)


@pytest.mark.parametrize("name", GEOMETRIES)
def test_each_has_the_requested_size_and_its_area_and_no_fold(name: str) -> None:
    found = GEOMETRIES[name](1500)
    assert found.points == pytest.approx(1500, rel=0.08)
    assert not found.mesh.is_folded
    assert found.area == pytest.approx(AREAS[name], rel=1e-7)
    assert found.points == found.layout.node_count == len(np.unique(found.mesh.cells))
    assert found.description()["blocks"] == DESCRIPTIONS[name]["blocks"]


def test_the_names_are_those_of_the_functions() -> None:
    assert list(GEOMETRIES) == list(DESCRIPTIONS)
    assert [function.__name__ for function in GEOMETRIES.values()] == list(GEOMETRIES)


def test_cells_of_neighbours_have_nearly_one_size_across_the_step() -> None:
    found = GEOMETRIES["pitz_daily"](12_500)
    assert [block.shape for block in found.mesh.blocks][1] == (181, 28)
    upright = np.concatenate([found.mesh.block_mesh(1).y[90], found.mesh.block_mesh(2).y[90, 1:]])
    heights = np.diff(upright)
    assert max(max(a / b, b / a) for a, b in pairwise(heights)) < 1.55


# The kit of domains: the project's own domains pass it, and it refuses each broken promise.


RISING = em.Curve.of_expressions("t", "1 + 0.1*t")
LEFT, RIGHT = em.Curve.of_expressions("0", "t"), em.Curve.of_expressions("1", "1.1*t")
DOMAINS: dict[str, em.Domain] = {
    "unit square": em.Rectangle(),
    "rectangle": em.Rectangle(x=(-3.0, 5.0), y=(1.0, 1.5)),
    "sector": em.AnnulusSector(center=(1.0, -2.0), radii=(0.5, 1.5), angles=(20.0, 250.0)),
    "periodic": em.Rectangle(x=(-3.0, 5.0), periodic="both"),
    "closed ring": em.AnnulusSector(closed=True),
    "ring": em.AnnulusSector(angles=(0.0, 360.0)),
    "formulas": em.Quadrilateral(
        bottom=em.Curve.of_expressions("t", "0.2*sin(pi*t)"), top=RISING, left=LEFT, right=RIGHT
    ),
    "splines": em.Quadrilateral(
        bottom=em.Curve.through([(0, 0), (0.3, 0.1), (0.7, -0.1), (1, 0)]), top=RISING, left=LEFT, right=RIGHT
    ),
}


@pytest.mark.parametrize("name", DOMAINS)
def test_own_domains_pass(name: str) -> None:
    check_domain(DOMAINS[name])


class Sheared:
    """A right domain: the unit square sheared and stretched, with ``changes`` of its members."""

    box = ((0.0, 2.5), (0.0, 1.0))
    area = 2.0

    def __init__(self, **changes: Any) -> None:
        for name, value in changes.items():
            setattr(self, name, value)

    def map(self, s: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 2 * s + 0.5 * t, t + 0 * s

    def jacobian(self, s: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, ...]:
        one = np.ones(np.broadcast_shapes(np.shape(s), np.shape(t)))
        return 2 * one, 0.5 * one, 0 * one, one


def outside(s: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return 2 * s + 0.5 * t, np.where(t < 0.0, np.nan, t) + 0 * s


def mirrored(s: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, ...]:
    one = np.ones(np.broadcast_shapes(np.shape(s), np.shape(t)))
    return -2 * one, 0.5 * one, 0 * one, one


def constants(s: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, ...]:  # noqa: ARG001
    one = np.ones(np.shape(s))
    return 2 * one, 0.5 * one, 0 * one, one


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"map": lambda s, t: (s.ravel(), t.ravel())}, r"map\(s, t\): x has shape"),
        ({"jacobian": constants}, r"jacobian\(s, t\) of shapes \(3, 1\) and \(1, 4\) has shapes \[\(3, 1\)\]"),
        ({"map": outside}, r"y is not finite at \(-1e-05, -1e-05\)"),
        ({"map": lambda s, t: (2 * s + 0.5 * t, t + 1e-3 * s)}, r"y_s = 0 is wrong by 0.001 at"),
        ({"jacobian": mirrored, "map": lambda s, t: (0.5 * t - 2 * s, t + 0 * s)}, "the determinant is -2 at"),
        ({"area": 2.001}, "area = 2.001, but the integral of the determinant .* is 2"),
        ({"box": ((0.0, 2.4), (0.0, 1.0))}, "box: the largest x of the domain is 2.5, not 2.4"),
        ({"box": ((0.0, 2.5), (-0.1, 1.0))}, "box: the least y of the domain is 0, not -0.1"),
    ],
)
def test_broken_promises_are_refused(changes: dict[str, Any], sentence: str) -> None:
    check_domain(Sheared())
    with pytest.raises(AssertionError, match=sentence):
        check_domain(Sheared(**changes))
