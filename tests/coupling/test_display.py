"""What a notebook shows of a mesh, and a mesh on axes of the reader's own."""

from __future__ import annotations

import base64
import re
import sys

import numpy as np
import pytest

import equimesh as em
from coupling.conftest import bent
from equimesh_coupling.display import MAX_BYTES, colours_of, draw_cells, error_of_cells

matplotlib = pytest.importorskip("matplotlib")
from matplotlib.figure import Figure  # noqa: E402 - after matplotlib is known to be here


@pytest.fixture(scope="module")
def front() -> em.Solution:
    solution: em.Solution = em.mesh("tanh(10*(x + y/2 - 0.75))", 17)
    return solution


def test_a_notebook_shows_a_small_picture_and_the_gain(front: em.Solution) -> None:
    page = front._repr_html_()
    assert len(page) < 100_000
    (source,) = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    picture = base64.b64decode(source)
    assert picture.startswith(b"\x89PNG")
    assert front.certificate.headline in page
    assert "17 x 17" in page


def test_the_picture_of_a_fine_mesh_is_small_and_has_no_background() -> None:
    from io import BytesIO

    from matplotlib.image import imread

    fine = em.mesh("tanh(20*(x + y/2 - 0.75))", 129, monitor="arc_length")
    (source,) = re.findall(r'base64,([^"]+)"', fine._repr_html_())
    data = base64.b64decode(source)
    assert len(data) <= MAX_BYTES
    assert imread(BytesIO(data)).shape[2] == 4


def test_without_matplotlib_the_table_is_shown(front: em.Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    page = front._repr_html_()
    assert "<img" not in page
    assert front.certificate.headline in page
    with pytest.raises(ImportError, match=r"equimesh\[plot\]"):
        front.plot()


def test_it_is_drawn_on_the_axes_that_are_given(front: em.Solution) -> None:
    left, right = Figure().subplots(1, 2)
    assert front.plot(right) is right
    assert not left.collections
    mesh, lines = right.collections
    np.testing.assert_allclose(mesh.get_array().size, front.mesh.cells.shape[0])
    assert len(lines.get_segments()) == 2 * 17
    assert right.get_xlim() == pytest.approx((0.0, 1.0), abs=0.1)


def test_the_name_of_a_file_is_no_axes(front: em.Solution) -> None:
    with pytest.raises(em.BadValues, match=r"axes = 'front\.png': .* \.plot\(\)\.figure\.savefig"):
        front.plot("front.png")  # type: ignore[arg-type]


def test_a_metric_without_u_has_no_gain() -> None:
    rho = em.Weight(rho=em.Expression("1 + 5*exp(-50*(x - 0.5)**2)"))
    solution = em.solve(em.Problem(monitor=rho, grid=em.Grid(n_xi=9, n_eta=9)))
    assert np.isnan(solution.gain)
    assert "interpolation error" not in solution._repr_html_()


def shown(page: str) -> list[str]:
    """The pictures in what a notebook shows, which has a table and is small."""
    assert "<table><tr>" in page
    assert len(page) < 100_000
    return re.findall(r'src="data:image/png;base64,([^"]+)"', page)


def test_meshes_steps_rounds_and_domains_show_themselves() -> None:
    u = em.Expression("tanh(6*(x - y))")
    problem = em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(9, 9))
    sequence = em.Sequence(problem)
    step = sequence.step("tanh(6*(x - y + 0.1))", {"T": sequence.mesh.x})
    rounds = em.adapt(lambda mesh: u.evaluate(mesh.x, mesh.y)[0], 9, rounds=1)
    blocks = em.Blocks.of_mesh(bent().points, bent().cells, bent().sides)
    one_round = em.adapt_round(step.mesh, step.mesh.x**2)
    for told, words in (
        (step.mesh, "9 x 9"),
        (blocks.mesh, "24 quadrilaterals"),
        (blocks, "24 quadrilaterals"),
        (step, "fields"),
        (sequence, step.certificate.headline),
        (rounds, "round 1"),
        (one_round, "of the gradient"),
    ):
        page = told._repr_html_()
        assert len(shown(page)) == 1, told
        assert words in page
        axes = Figure().subplots()
        assert told.plot(axes) is axes
        assert not np.ma.is_masked(axes.collections[0].norm(axes.collections[0].get_array()))  # no cell is grey
    assert shown(step.certificate._repr_html_()) == []
    assert "smallest Jacobian" in step.certificate._repr_html_()


def test_the_error_of_a_cell_is_estimated_from_values_at_the_nodes() -> None:
    u = em.Expression("x^2 + 3*y")
    uniform = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=5))
    found = error_of_cells(uniform, u.evaluate(uniform.x, uniform.y)[0])
    np.testing.assert_allclose(found, (1 / 8) ** 2 / 4)  # what a parabola has in the middle of an edge
    bend = bent(33, 25)
    np.testing.assert_allclose(error_of_cells(bend, 2 * bend.x - bend.y), 0.0, atol=1e-12)  # bent lines alone: none
    steep = em.Expression("tanh(4*(x - 0.5))").evaluate(bend.x, bend.y)[0]
    blocks = em.Blocks.of_mesh(bend.points, bend.cells, bend.sides).mesh
    np.testing.assert_allclose(error_of_cells(blocks, steep.ravel()), error_of_cells(bend, steep).ravel())
    indicator = -np.ones(bend.cell_shape)
    np.testing.assert_array_equal(error_of_cells(bend, indicator), 1.0)
    assert error_of_cells(bend, np.zeros(7)) is None


def test_a_grid_blocks_and_cells_without_order_have_the_same_colours_and_edges() -> None:
    grid = bent()
    blocks = em.Blocks.of_mesh(grid.points, grid.cells, grid.sides).mesh
    loose = em.Mesh(points=grid.points, cells=grid.cells, sides=blocks.sides)
    error = np.linspace(1.0, 2.0, len(grid.cells))
    edges_of, colours = [], []
    for mesh, values in ((grid, error.reshape(grid.cell_shape)), (blocks, error), (loose, error)):
        axes = Figure().subplots()
        draw_cells(axes, mesh, values, colours_of([values]))
        *cells, lines = axes.collections
        colours.append(np.sort(np.concatenate([np.ravel(one.get_array()) for one in cells])))
        edges = {
            tuple(np.round(np.sort(line[k : k + 2], axis=0).ravel(), 9))
            for line in lines.get_segments()
            for k in range(len(line) - 1)
        }
        edges_of.append(edges)
    assert edges_of[0] == edges_of[1] == edges_of[2]
    np.testing.assert_array_equal(colours[0], colours[1])
    np.testing.assert_array_equal(colours[0], colours[2])
