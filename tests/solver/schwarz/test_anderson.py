"""Anderson acceleration: exact on linear iterations of few modes, silent where it knows nothing, never folded."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.schwarz.acceleration import Anderson
from equimesh.schwarz.merged_mesh import MergedMeshes

UNIFORM = em.Mesh.uniform(em.Grid(n_xi=6, n_eta=5))
BUMP = np.sin(np.pi * UNIFORM.x) * np.sin(np.pi * UNIFORM.y)
WHOLE = MergedMeshes(em.Decomposition(grid=UNIFORM.grid, subdomains=(2, 1), overlap=2))
MODES = (BUMP, BUMP * np.cos(np.pi * UNIFORM.x), BUMP * np.cos(np.pi * UNIFORM.y))


def moved(sizes: list[float]) -> em.Mesh:
    """The uniform mesh, moved by a multiple of each mode."""
    shift = sum(size * mode for size, mode in zip(sizes, MODES, strict=False))
    return em.Mesh(UNIFORM.x + shift, UNIFORM.y - 0.5 * shift)


def test_a_linear_iteration_of_few_modes_ends_at_its_fixed_point() -> None:
    """As many modes with factors of their own, so many combinations: a Krylov method."""
    factors, sizes, anderson = [0.9, -0.5, 0.3], [0.02, 0.03, -0.02], Anderson(WHOLE)
    state = moved(sizes)
    for k in range(4):
        result = em.Mesh(UNIFORM.x.copy(), UNIFORM.y.copy())
        for factor, mode in zip(factors, MODES, strict=True):
            share = np.vdot(state.x - UNIFORM.x, mode) / np.vdot(mode, mode)
            result.x[:] += factor * share * mode
            result.y[:] -= 0.5 * factor * share * mode
        combined = anderson.combine(state, result)
        assert (combined is None) == (k == 0), "of one result nothing is known"
        state = result if combined is None else combined
    assert abs(state.x - UNIFORM.x).max() < 1e-9
    assert abs(state.y - UNIFORM.y).max() < 1e-9


def test_where_two_iterations_change_the_same_nothing_is_known() -> None:
    anderson, start, result = Anderson(WHOLE), moved([0.01]), moved([0.02])
    assert anderson.combine(start, result) is None
    assert anderson.combine(start, result) is None


@pytest.mark.parametrize(("second", "folds"), [(0.039, True), (0.03, False)])
def test_a_combination_that_folds_is_left_out(second: float, folds: bool) -> None:
    """From a geometric sequence it goes to the limit: far outside where the changes hardly shrink."""
    anderson = Anderson(WHOLE)
    assert anderson.combine(moved([0.0]), moved([0.02])) is None
    combined = anderson.combine(moved([0.02]), moved([second]))
    if folds:
        assert combined is None
    else:
        assert not combined.is_folded
        assert combined.x == pytest.approx(moved([0.02 / (1 - 0.5)]).x)
