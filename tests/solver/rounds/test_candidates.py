"""The candidates for the next mesh."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import UNIT_SQUARE, map_mesh
from equimesh.fields.on_domain import OnDomain
from equimesh.least_error.starts import mesh_of, rectilinear
from equimesh.quality.interpolation import interpolation_errors
from equimesh.rounds.candidates import LINE_FLOORS, LINES, MAX_CLIMBING, SAMPLED, STRAIGHT, Search

NAMES = [*(name for name, *_ in SAMPLED), LINES, STRAIGHT]
FRONT, LAYERS = em.Expression("tanh(20*(x + y/2 - 0.75))"), em.Expression("exp(50*(x - 1)) + exp(50*(y - 1))")


def search(u: em.Field, n: int, m: int, norm: str = "l2") -> Search:
    return Search(u=u, domain=UNIT_SQUARE, before=em.Mesh.uniform(em.Grid(n_xi=n, n_eta=m)), norm=norm)


def test_the_best_of_the_candidates_have_their_measured_errors() -> None:
    found = list(search(FRONT, 33, 33).candidates())
    names = [one.name for one in found]
    assert len(names) == len({*names}) == MAX_CLIMBING + 1
    assert {*names} < {*NAMES}
    for one in found:
        mesh = mesh_of(one.mesh, em.Grid(n_xi=33, n_eta=33))
        assert mesh.min_jacobian > 0
        assert one.error == pytest.approx(interpolation_errors(mesh, FRONT).l2, rel=0.15)


def test_straight_lines_are_as_good_as_any_for_layers_and_poor_for_an_oblique_front() -> None:
    for u, low, high in ((FRONT, 2.0, 20.0), (LAYERS, 1.0, 1.3)):
        errors = {one.name: one.error for one in search(u, 33, 33).candidates()}
        assert low <= errors[STRAIGHT] / min(errors.values()) <= high


def test_the_last_steps_lower_the_error() -> None:
    here = search(FRONT, 33, 25)
    best = min(here.candidates(), key=lambda one: one.error)
    finished = here.finished(best)
    assert finished.error < 0.97 * best.error
    assert not mesh_of(finished.mesh, here.before.grid).is_folded


@pytest.mark.parametrize(("n", "m"), [(4, 4), (9, 9), (12, 30), (17, 65)])
def test_every_grid_has_candidates(n: int, m: int) -> None:
    here = search(FRONT, n, m)
    found = list(here.candidates())
    assert len(found) >= 3
    assert len({one.name for one in found}) == len(found)
    assert here.finished(found[0]).mesh.shape == (2, n * m)


def test_a_mesh_that_folds_on_coarse_grids_still_has_candidates_that_begin_with_it() -> None:
    uniform = em.Mesh.uniform(em.Grid(n_xi=65, n_eta=65))
    x, y = uniform.x - 0.5, uniform.y - 0.5
    turn = 2.2 * np.maximum(0.0, 1.0 - (x * x + y * y) / 0.2) ** 2  # a whirl
    whirl = em.Mesh(0.5 + np.cos(turn) * x - np.sin(turn) * y, 0.5 + np.sin(turn) * x + np.cos(turn) * y)
    assert not whirl.is_folded
    assert em.Mesh(whirl.x[::8, ::8], whirl.y[::8, ::8]).is_folded
    names = {one.name for one in Search(u=FRONT, domain=UNIT_SQUARE, before=whirl, norm="l2").candidates()}
    assert names & {name for name, *_ in SAMPLED}


def test_candidates_of_a_domain_with_curved_sides_are_not_folded() -> None:
    domain = em.AnnulusSector(radii=(1.0, 2.0))
    ring = em.Expression("tanh(40*(sqrt(x**2 + y**2) - 1.5))")
    here = Search(u=ring, domain=domain, before=em.Mesh.uniform(em.Grid(n_xi=33, n_eta=33)), norm="l2")
    errors = {}
    for one in here.candidates():
        mesh = map_mesh(mesh_of(one.mesh, here.before.grid), domain)
        assert not mesh.is_folded
        errors[one.name] = one.error
    assert errors[STRAIGHT] < 0.9 * max(errors.values())


def test_candidates_that_are_folded_on_the_domain_alone_are_left_out() -> None:
    domain = em.AnnulusSector(radii=(0.5, 1.0), angles=(0.0, 350.0))
    # Straight lines crowd at the last angles; the first cell then spans more than half a turn.
    steep = OnDomain(reference=em.Expression("tanh(200*(y - 0.95))"), domain=domain)
    before = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    lines = rectilinear(steep, domain, before.grid.shape, "l2", LINE_FLOORS[-1])
    assert lines is not None
    straight = em.Mesh(*np.meshgrid(*lines, indexing="ij"))
    assert not straight.is_folded
    assert map_mesh(straight, domain).is_folded
    for one in Search(u=steep, domain=domain, before=before, norm="l2").candidates():
        assert not map_mesh(mesh_of(one.mesh, before.grid), domain).is_folded
