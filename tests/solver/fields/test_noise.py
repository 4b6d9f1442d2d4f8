"""The estimate of noise in samples: what is put in comes out, and u itself is not taken for noise."""

import numpy as np
import pytest

import equimesh as em
from equimesh.fields.noise import noise_share

POINTS = 65
AXIS = np.linspace(0.0, 1.0, POINTS)
X, Y = np.meshgrid(AXIS, AXIS, indexing="ij")
FUNCTIONS = {
    "front": np.tanh(20 * (X - Y**2)),
    "waves": np.sin(4 * np.pi * X) * np.sin(4 * np.pi * Y),
    "peak": np.exp(-200 * ((X - 0.5) ** 2 + (Y - 0.5) ** 2)),
    "jump": np.where(X + Y < 0.9, 0.0, 1.0),
}


def noisy(values: np.ndarray, share: float) -> np.ndarray:
    return values + share * np.ptp(values) * np.random.default_rng(1).standard_normal(values.shape)


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("share", [1e-3, 1e-2])
def test_noise_of_samples_on_a_grid_is_estimated_within_a_third(name: str, share: float) -> None:
    samples = em.GridSamples(x=AXIS, y=AXIS, values=noisy(FUNCTIONS[name], share))
    assert noise_share(samples) == pytest.approx(share, rel=0.34)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_without_noise_has_none(name: str) -> None:
    assert noise_share(em.GridSamples(x=AXIS, y=AXIS, values=FUNCTIONS[name])) < 1e-9


def test_nodal_values_and_scattered_samples_are_seen_too() -> None:
    values = noisy(FUNCTIONS["front"], 1e-2)
    mesh = em.Mesh.uniform(em.Grid(n_xi=POINTS, n_eta=POINTS))
    assert noise_share(em.NodalField(mesh=mesh, values=values)) == pytest.approx(1e-2, rel=0.34)
    points = np.vstack([np.random.default_rng(2).random((4000, 2)), [[0, 0], [0, 1], [1, 0], [1, 1]]])
    u = np.tanh(20 * (points[:, 0] - points[:, 1] ** 2))
    assert noise_share(em.ScatteredSamples(points=points, values=u)) < 1e-6
    assert noise_share(em.ScatteredSamples(points=points, values=noisy(u, 1e-2))) == pytest.approx(1e-2, rel=0.34)


def test_expressions_and_few_samples_have_none() -> None:
    assert noise_share(em.Expression("tanh(20*x)")) == noise_share(None) == 0.0
    axis = np.linspace(0.0, 1.0, 8)
    values = np.random.default_rng(3).random((8, 8))
    assert noise_share(em.GridSamples(x=axis, y=axis, values=values)) == 0.0


def test_constant_samples_have_none() -> None:
    assert noise_share(em.GridSamples(x=AXIS, y=AXIS, values=np.ones((POINTS, POINTS)))) == 0.0


def test_the_certificate_names_the_noise() -> None:
    samples = em.GridSamples(x=AXIS, y=AXIS, values=noisy(FUNCTIONS["front"], 1e-2))
    problem = em.Problem(monitor=em.LeastError(u=samples), grid=em.Grid(n_xi=17, n_eta=17))
    (warning,) = (text for text in em.solve(problem).certificate.warnings if "noise" in text)
    assert "noise of about 1 %" in warning or "noise of about 0.9" in warning or "noise of about 1." in warning
