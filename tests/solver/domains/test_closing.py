"""Closed lines: which there are, and the second copies of seams."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import close_seam, closed_of, is_closed, map_mesh, periods_of


@pytest.mark.parametrize(("periodic", "closed"), [(None, (0, 0)), ("x", (1, 0)), ("y", (0, 1)), ("both", (1, 1))])
def test_lines_across_a_periodic_direction_are_closed(periodic: str | None, closed: tuple[int, int]) -> None:
    domain = em.Rectangle(x=(1.0, 4.0), y=(0.0, 2.0), periodic=periodic)  # type: ignore[arg-type]
    assert closed_of(domain) == closed
    assert is_closed(domain) == any(closed)
    assert periods_of(domain) == ((3.0 * closed[0], 0.0), (0.0, 2.0 * closed[1]))


def test_a_domain_that_says_nothing_has_four_sides() -> None:
    assert closed_of(object()) == (False, False)
    assert periods_of(object()) == ((0.0, 0.0), (0.0, 0.0))


def test_the_second_copy_is_the_first_one_moved_by_the_period() -> None:
    rng = np.random.default_rng(1)
    x, y = rng.random((5, 4)), rng.random((5, 4))
    close_seam(x, y, em.Rectangle(x=(0.0, 3.0), periodic="both"))
    assert np.array_equal(x[-1], x[0] + 3.0)
    assert np.array_equal(y[-1], y[0])
    assert np.array_equal(y[:, -1], y[:, 0] + 1.0)


def test_a_closed_ring_is_one_turn_and_its_seam_is_one_line() -> None:
    ring = em.AnnulusSector(closed=True)
    assert ring.angles == (0.0, 360.0)
    mesh = map_mesh(em.Mesh.uniform(em.Grid(n_xi=5, n_eta=9)), ring)
    assert np.array_equal(mesh.x[:, -1], mesh.x[:, 0])
    assert np.array_equal(mesh.y[:, -1], mesh.y[:, 0])


def test_an_open_line_named_closed_is_refused() -> None:
    with pytest.raises(em.InputError, match=r"span 300 degrees: the lines around a ring close after 360") as error:
        em.AnnulusSector(angles=(0.0, 300.0), closed=True)
    assert error.value.field == "domain.closed"
    with pytest.raises(em.InputError, match="choose 'x', 'y' or 'both'") as error:
        em.Rectangle(periodic="z")  # type: ignore[arg-type]
    assert error.value.field == "domain.periodic"
