"""Finite volumes in OpenFOAM itself: the numbers of the certificate and of the preset are those of its programs.

`apt-get install openfoam`.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import finite_volumes
import finite_volumes_cases as cases
import pytest

import equimesh as em
from equimesh.quality.faces import poisson_error

pytestmark = [
    pytest.mark.external,
    pytest.mark.skipif(shutil.which("electrostaticFoam") is None, reason="needs OpenFOAM: apt-get install openfoam"),
]


@pytest.mark.parametrize("domain", [em.Rectangle(), em.AnnulusSector()], ids=["square", "annulus"])
def test_the_certificate_has_the_numbers_of_check_mesh_and_the_error_of_a_solve(
    domain: em.Domain, tmp_path: Path
) -> None:
    u = em.Expression("tanh(8*(x + y/2 - 0.75))")
    grid = em.Grid(n_xi=33, n_eta=33)
    solution = em.solve(em.Problem(monitor=em.ArcLength(u=u, orthogonality=50), grid=grid, domain=domain))
    solved = cases.open_foam(tmp_path, solution.mesh, u)
    assert cases.check_mesh(tmp_path).angle == pytest.approx(solution.faces.non_orthogonality, rel=1e-6)
    assert solved.last < 1e-6
    assert solved.error == pytest.approx(poisson_error(solution.mesh, u), rel=1e-4)


@pytest.mark.parametrize("name", ["paper", "ring20", "layers"])
def test_the_preset_reaches_its_goals(name: str) -> None:
    row = finite_volumes.measured(name, 65)
    assert row.uniform / row.ours > finite_volumes.GOALS[name]
    assert row.checked
    assert row.last < 1e-6
