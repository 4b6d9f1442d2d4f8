"""The request for the next mesh of a solver."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.second_order import lattice_of

NODES = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
VALUES = np.tanh(5.0 * (NODES.x - NODES.y))
NODAL = em.NodalField(mesh=NODES, values=VALUES)


def test_a_bound_one_measures_the_recovered_solution_and_knows_its_nodes() -> None:
    bound = em.NodalSolution(u=NODAL).on(em.Rectangle())
    assert bound.u is not NODAL
    assert bound.u.evaluate(NODES.x, NODES.y)[0] == pytest.approx(VALUES, abs=1e-12)
    assert bound.nodal is NODAL
    assert bound.on(em.Rectangle()) is bound
    wider = bound.on(em.Rectangle(x=(0.0, 1.0), y=(0.0, 1.0)))
    assert wider.nodal is NODAL
    assert pickle.loads(pickle.dumps(bound)).metric(0.5, 0.5)[0] == bound.metric(0.5, 0.5)[0]


def test_equal_requests_are_equal() -> None:
    one, other = em.NodalSolution(u=NODAL), em.NodalSolution(u=em.NodalField(mesh=NODES, values=VALUES.copy()))
    assert one == other == one.on(em.Rectangle())
    assert hash(one) == hash(other)
    assert one != em.NodalSolution(u=NODAL, norm="h1")
    assert one != em.NodalSolution(u=em.NodalField(mesh=NODES, values=VALUES + 1.0))
    assert one != "a round"


def test_an_adjoint_belongs_to_the_request() -> None:
    adjoint = em.NodalField(mesh=NODES, values=VALUES**2)
    one = em.NodalSolution(u=NODAL, adjoint=adjoint)
    assert one == one.on(em.Rectangle()).on(em.Rectangle(x=(0.0, 1.0), y=(0.0, 1.0)))
    assert one.dual is not None
    assert one != em.NodalSolution(u=NODAL)
    assert one != em.NodalSolution(u=NODAL, adjoint=NODAL)
    moved = em.Mesh(NODES.x**2, NODES.y)
    for other in (em.Expression("x"), em.NodalField(mesh=moved, values=VALUES)):
        with pytest.raises(em.InputError, match="the adjoint belongs to another mesh than u"):
            em.NodalSolution(u=NODAL, adjoint=other)
    with pytest.raises(em.InputError, match="on elements of degree 1 alone"):
        em.NodalSolution(u=NODAL, adjoint=adjoint, degree=2)


def test_earlier_values_belong_to_the_request() -> None:
    moved = em.Mesh(NODES.x**2, NODES.y)
    one = em.NodalSolution(u=NODAL, earlier=em.NodalField(mesh=moved, values=VALUES))
    assert one == one.on(em.Rectangle())
    assert one != em.NodalSolution(u=NODAL)
    blocks = em.Blocks.rectangle(cells=(4, 4)).mesh
    for other in (em.Expression("x"), em.QuadField(mesh=blocks, values=np.zeros(len(blocks.points)))):
        with pytest.raises(em.InputError, match="not those at the nodes of a mesh of the same kind"):
            em.NodalSolution(u=NODAL, earlier=other)
    twice = np.zeros((17, 17))
    with pytest.raises(em.InputError, match="for elements of degree 1"):
        em.NodalSolution(u=em.NodalField(mesh=lattice_of(NODES, 2), values=twice), degree=2, earlier=NODAL)


def test_what_is_refused() -> None:
    with pytest.raises(em.InputError, match="values of a solver at the nodes"):
        em.NodalSolution(u=em.Expression("x"))
    with pytest.raises(em.InputError, match="norm = 'l3'"):
        em.NodalSolution(u=NODAL, norm="l3")
    with pytest.raises(em.InputError, match=r"call monitor\.on"):
        em.NodalSolution(u=NODAL).metric(NODES.x, NODES.y)
    with pytest.raises(em.InputError, match="the grid has 17 x 17 points, the values are 9 x 9"):
        em.NodalSolution(u=NODAL).require_grid(em.Grid(n_xi=17, n_eta=17))


def test_values_of_quadratic_elements_are_on_the_lattice_of_the_mesh() -> None:
    """So the 9 x 9 nodes are those of elements on 5 x 5."""
    quadratic, grid = em.NodalSolution(u=NODAL, degree=2), em.Grid(5)
    quadratic.require_grid(grid)
    assert quadratic != em.NodalSolution(u=NODAL)
    assert quadratic.mesh_on(em.Rectangle()).grid == grid
    assert quadratic.on(em.Rectangle()).least_error.degree == 2
    with pytest.raises(em.InputError, match="on 9 x 9 points elements of degree 2 have 17 x 17 nodes, and the"):
        quadratic.require_grid(em.Grid(9))
    with pytest.raises(em.InputError, match="degree = 5: give 1 to 4"):
        em.NodalSolution(u=NODAL, degree=5)
    found = em.solve(em.Problem(monitor=quadratic, grid=grid))
    assert found.mesh.distance(em.adapt_round(em.Mesh.uniform(grid), VALUES, degree=2).mesh) == 0.0


@pytest.mark.parametrize("blocks", [False, True])
def test_values_of_quadratic_triangles_are_at_the_middles_of_the_cuts(blocks: bool) -> None:
    domain: Any = em.Blocks.rectangle(cells=(3, 3)) if blocks else em.Rectangle()
    s, t = np.meshgrid(np.linspace(0.0, 1.0, 5), np.linspace(0.0, 1.0, 5), indexing="ij")
    bent = em.Mesh(s + 0.2 * s * (1 - s) * t, t + 0.3 * t * (1 - t) * (1 - s))
    if blocks:
        ways = domain.mesh.points * (1.0 - domain.mesh.points)
        bent = domain.mesh.moved(domain.mesh.points + 1.5 * ways[:, ::-1] * ways)
    found = []
    for cells in ("quad", "triangle"):
        nodes: Any = lattice_of(bent, 2, cells)  # type: ignore[arg-type]
        u = (em.QuadField if blocks else em.NodalField)(mesh=nodes, values=np.sin(3 * nodes.x) * nodes.y)
        found.append(em.NodalSolution(u=u, degree=2, cells="triangle"))
    centres, middles = found
    assert middles.mesh_on(domain).distance(bent) == 0.0
    assert middles != em.NodalSolution(u=middles.u, degree=2)
    assert middles.on(domain).least_error.cells == "triangle"
    inner = 9 if blocks else 16
    with pytest.raises(em.InputError, match=f"of {inner}: of degree 2 on triangles .*mesh, 2, .triangle"):
        centres.on(domain)
    if not blocks:
        with pytest.raises(em.InputError, match="have 13 x 13 nodes, and the values are 9 x 9; of degree 2 on"):
            middles.require_grid(em.Grid(7))
    problem: Any = em.Problem(monitor=middles, domain=domain, grid=None if blocks else em.Grid(5))
    solution, values = em.solve(problem), middles.nodal.values
    own = em.adapt_round(middles.mesh_on(domain), values, domain, degree=2, cells="triangle")
    assert solution.mesh.distance(own.mesh) == 0.0


def test_values_at_the_nodes_of_other_blocks_are_refused_by_their_number() -> None:
    nodes = lattice_of(em.Blocks.rectangle(cells=(2, 2)).mesh, 3)
    cubic = em.NodalSolution(u=em.QuadField(mesh=nodes, values=nodes.points[:, 0]), degree=3)
    with pytest.raises(em.InputError, match="at 49 nodes, and elements of degree 3 have 100 on") as told:
        cubic.on(em.Blocks.rectangle(cells=(3, 3)))
    assert told.value.field == "u"
