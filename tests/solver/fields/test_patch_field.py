"""u from values at the nodes of elements of a higher degree, by polynomials on patches."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from block_cases import channel, l_shape
from equimesh.errors import InputError, SamplesError
from equimesh.fields.patch_field import PatchField
from equimesh.least_error.kernels import Norm, Rule
from equimesh.meshes.second_order import lattice_of, require_degree
from equimesh.rounds.norms import measured
from equimesh.rounds.recovery import Recovery

DEGREES = [2, 3, 4]
POINTS = np.random.default_rng(5).uniform(0.0, 1.0, (2, 40))


def wavy(count: int = 9) -> em.Mesh:
    """A mesh of oblique cells."""
    plain = em.Mesh.uniform(em.Grid(n_xi=count, n_eta=count))
    bump = 0.06 * np.sin(np.pi * plain.x) * np.sin(2 * np.pi * plain.y)
    return em.Mesh(plain.x + bump, plain.y + bump)


def field(u: em.Field, degree: int, mesh: em.Mesh | None = None) -> PatchField:
    mesh = wavy() if mesh is None else mesh
    nodes = lattice_of(mesh, degree)
    return PatchField(mesh=mesh, values=u.evaluate(nodes.x, nodes.y)[0], degree=degree)


@pytest.mark.parametrize("degree", DEGREES)
def test_polynomials_of_two_degrees_more_are_exact_with_their_derivatives(degree: int) -> None:
    u = em.Expression(f"(x - 0.3)**{degree + 2} + x**2*y**{degree} - y")
    found, exact = (one.evaluate(*POINTS, order=2) for one in (field(u, degree), u))
    for part, wanted in zip(found, exact, strict=True):
        np.testing.assert_allclose(part, wanted, atol=1e-8)


@pytest.mark.parametrize("degree", [3, 4])
def test_polynomials_are_exact_on_blocks_and_go_on_beyond_a_join(degree: int) -> None:
    u, blocks = em.Expression(f"(x - 0.3)**{degree + 2} + y"), l_shape()
    inside = blocks.points[blocks.cells].mean(axis=1).T
    for one, other in zip(field(u, degree, blocks).evaluate(*inside, order=2), u.evaluate(*inside, 2), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6 * np.abs(other).max() + 1e-9)
    joined, wave = channel(), em.Expression("sin(pi*x)")
    ends = joined.points[joined.ties[1:3]].mean(axis=0)  # places on both sides of the join that are one
    across, wave_of = np.array([[1.0, 0.0], [-1.0, 0.0]]), field(wave, degree, joined)
    for step in (-1e-9, 0.01):
        places = (ends + step * across).T
        for part, wanted in zip(wave_of.evaluate(*places, order=1), wave.evaluate(*places, order=1), strict=True):
            np.testing.assert_allclose(part, wanted, atol=2e-3)


@pytest.mark.parametrize("cells", [(6, 1), (1, 1)])
def test_polynomials_are_of_the_degree_of_the_elements_where_one_cell_lies_between_two_sides(
    cells: tuple[int, int],
) -> None:
    mesh = em.Blocks.rectangle(cells=cells).mesh
    for text, most in (("x**3 - x*y**2 + y", 1e-12), ("sin(2*x + y)", 0.02)):  # in between u was wrong by 1e10
        u = em.Expression(text)
        difference = field(u, 3, mesh).evaluate(*POINTS)[0] - u.evaluate(*POINTS)[0]
        assert np.abs(difference).max() < most


@pytest.mark.parametrize("degree", DEGREES)
def test_the_values_stay_at_the_nodes_and_derivatives_are_those_of_u(degree: int) -> None:
    u, mesh, step = em.Expression("tanh(20*(x + y/2 - 0.75))"), wavy(), 1e-6
    found, nodes = field(u, degree, mesh), lattice_of(mesh, degree)
    np.testing.assert_allclose(found.evaluate(nodes.x, nodes.y)[0], found.values, atol=1e-12)
    centres = mesh.points[mesh.cells].mean(axis=1).T
    _, u_x, u_y, u_xx, u_xy, u_yy = found.evaluate(*centres, order=2)
    for dx, dy, wanted in ((step, 0.0, (u_x, u_xx, u_xy)), (0.0, step, (u_y, u_xy, u_yy))):
        after, before = (found.evaluate(centres[0] + s * dx, centres[1] + s * dy, order=1) for s in (1, -1))
        for part, one, other in zip(wanted, after, before, strict=True):
            np.testing.assert_allclose((one - other) / (2.0 * step), part, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("degree", [3, 4])
def test_the_estimate_is_the_error_of_interpolation_where_u_is_resolved(degree: int) -> None:
    u, mesh = em.Expression("sin(3*x + 1)*cos(2*y) + exp(x*y)"), wavy(17)
    nodes = lattice_of(mesh, degree)
    known = Recovery.of(mesh, u.evaluate(nodes.x, nodes.y)[0], em.Rectangle(), require_degree(degree))
    norms: tuple[Norm, ...] = ("l2", "h1")
    for norm in norms:
        exact = measured(u, em.Rectangle(), mesh, Rule(norm=norm, points=degree + 3, degree=degree))
        assert known.estimate(norm) == pytest.approx(exact, rel=0.1)


def test_what_cannot_be_used_is_refused() -> None:
    mesh, nodes = wavy(), lattice_of(wavy(), 3)
    with pytest.raises(SamplesError, match="values has shape"):
        PatchField(mesh=mesh, values=mesh.x, degree=3)
    with pytest.raises(InputError, match="the mesh is folded"):
        PatchField(mesh=em.Mesh(mesh.x, mesh.x), values=nodes.x, degree=3)
    assert np.isnan(field(em.Expression("x"), 3).evaluate(np.array([np.nan]), np.array([0.5]))[0]).all()
