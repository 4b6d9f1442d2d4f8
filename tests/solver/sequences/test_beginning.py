"""What a sequence begins with."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.errors import InputError
from equimesh.sequences.sequence import check_settings, first_mesh
from solver.fields.bent_meshes import smooth_mesh

RING = em.AnnulusSector()
FLAT = em.Problem(monitor=em.Weight(rho=em.Expression("1 + x")), grid=em.Grid(n_xi=9, n_eta=9))


@pytest.mark.parametrize(
    ("changed", "field"),
    [
        ({"smoothing": "a"}, "smoothing"),
        ({"smoothing": None}, "smoothing"),
        ({"smoothing": 1.0}, "smoothing"),
        ({"max_move": None}, "max_move"),
        ({"max_move": -1}, "max_move"),
        ({"outrun": None}, "outrun"),
    ],
)
def test_settings_of_another_kind_are_refused(changed: dict[str, Any], field: str) -> None:
    good: dict[str, Any] = {"smoothing": 0, "max_move": np.float32(2.0), "outrun": "refuse"}
    check_settings(**good)
    with pytest.raises(InputError, match=f"{field} = ") as caught:
        check_settings(**{**good, **changed})
    assert caught.value.field == field


@pytest.mark.parametrize("domain", [RING, em.Rectangle(x=(2.0, 5.0)), em.AnnulusSector(angles=(0, 360))])
def test_a_mesh_of_the_domain_comes_with_its_reference(domain: em.Domain) -> None:
    plain = smooth_mesh(17, depth=0.02)
    square = em.Mesh(plain.x, plain.y**2)  # there are inner nodes near the cut of the full ring
    mesh = map_mesh(em.Mesh.of_unit_square(square.x, square.y), domain)
    found, reference = first_mesh(mesh, domain)
    assert found is mesh
    assert reference.distance(square) < 1e-9


def test_a_mesh_of_another_domain_is_refused() -> None:
    square = smooth_mesh(9)
    for mesh in (em.Mesh(0.9 * square.x, square.y), em.Mesh(square.x + 10.0, square.y), map_mesh(square, RING)):
        with pytest.raises(InputError, match="one of the problem's domain"):
            first_mesh(mesh, em.Rectangle())
    solution = em.solve(FLAT, threads=1)
    assert first_mesh(solution, FLAT.domain) == (solution.mesh, solution.reference)
    with pytest.raises(InputError, match="one of the problem's domain"):
        first_mesh(solution, RING)


@pytest.mark.parametrize("begin", [None, "x", np.zeros((9, 9, 2))])
def test_what_is_no_mesh_is_refused(begin: Any) -> None:
    with pytest.raises(InputError, match="cannot begin with"):
        first_mesh(begin, em.Rectangle())


def test_a_sequence_begins_with_one_thing_alone() -> None:
    solution = em.solve(FLAT, threads=1)
    with pytest.raises(InputError, match="and not both"):
        em.Sequence(FLAT, solution=solution, mesh=solution.mesh)
    with pytest.raises(InputError, match="cannot begin with the text 'x'"):
        em.Sequence(FLAT, mesh="x")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="u is the class LeastError"):
        em.Sequence(FLAT, solution=solution).step(em.LeastError)
