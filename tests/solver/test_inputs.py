"""Options as words, and arguments of the wrong kind: taken at their word, or refused with a remedy."""

from __future__ import annotations

import dataclasses
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.inputs import real_array

U = em.Expression("tanh(20*(x + y/2 - 0.75))")
GRID = em.Grid(n_xi=17, n_eta=17)


def test_words_are_what_they_name() -> None:
    case = em.Problem(monitor=em.ArcLength(u=U), grid=GRID, boundary="orthogonal")  # type: ignore[arg-type]
    assert case.boundary is em.Boundary.ORTHOGONAL
    assert em.Schwarz(ordering="parallel").ordering is em.Ordering.PARALLEL  # type: ignore[arg-type]
    word = em.solve(problem("tanh20", 33), mode="tight")  # type: ignore[arg-type]
    member = em.solve(problem("tanh20", 33), mode=em.Mode.TIGHT)
    assert word.mode is em.Mode.TIGHT
    assert np.array_equal(word.mesh.x, member.mesh.x)
    assert word.certificate.equation_residual < 1e-9


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda: em.Problem(monitor=em.ArcLength(u=U), grid=GRID, boundary="open"), "'trace', 'equidistributed_1d'"),
        (lambda: em.solve(problem("paper", 9), mode="tigth"), "mode = 'tigth': choose one of 'discretization'"),
        (lambda: em.solve(problem("paper", 9), initial="zero"), "'nested', 'uniform'"),
        (lambda: em.solve(problem("paper", 9), allow_relaxed="no"), "allow_relaxed = no: give True or False"),
        (lambda: em.Schwarz(ordering="random"), "'parallel', 'alternating'"),
        (lambda: em.Curvature(u=abs), "u = the function abs cannot be evaluated here: give a formula as a text, or"),
        (lambda: em.Curvature(u=np.eye(3)), r"values as em.GridSamples\(x=..., y=..., values=...\) on a grid"),
        (lambda: em.Weight(rho=2.0), "rho = '2.0'"),
        (lambda: em.Tensor(m11=U, m12=0.0, m22=U), "m12 = '0.0'"),
        (lambda: em.Problem(monitor=em.ArcLength(u=U), grid=33), r"Grid\(n_xi=..., n_eta=...\)"),
        (lambda: em.Problem(monitor="curvature", grid=GRID), "is no monitor"),
        (lambda: em.Problem(monitor=em.Auto, grid=GRID), r"is no monitor: give one, such as Auto\(u=...\)"),
        (lambda: em.Grid(33.5), "n_xi = 33.5: give a whole number of points"),
        (lambda: em.Problem(monitor=em.ArcLength(u=U), grid=GRID, domain=(0, 2)), r"give one, such as Rectangle\("),
        (lambda: em.solve_to(400, monitor=em.Auto(u=U)), r"target = 400: give Target\(max_points=4000\) or"),
        (lambda: em.solve_to(em.Target(max_points=99), monitor="tanh(x)"), "is no monitor"),
        (lambda: em.solve_to(em.Target(max_points=99), monitor=em.Auto(u=U), domain={}), "give one, such as Rect"),
        (lambda: em.Target(max_points="400"), "max_points = '400': give a whole number, of at least 25 points"),
        (lambda: em.adapt(abs, points="400"), "points = '400': give a whole number, of at least 25 points"),
        (lambda: em.solve("tanh(x)"), r"problem = 'tanh\(x\)' is no problem: give Problem\("),
        (lambda: em.solve(problem("paper", 9), 4), r"schwarz = '4' are no settings .* give Schwarz\("),
    ],
)
def test_what_is_of_another_kind_is_refused(wrong: object, said: str) -> None:
    with pytest.raises(em.InputError, match=said):
        wrong()  # type: ignore[operator]


@pytest.mark.parametrize("number", [np.float32(0.25), np.longdouble(0.25), Fraction(1, 4), np.int64(1)])
def test_settings_of_other_real_numbers_become_floats(number: Any) -> None:
    least, smoothed = (
        em.LeastError(u=U, distortion=number, smoothness=number, obliqueness=number),
        em.Smoothed(monitor=em.ArcLength(u=U, a=number, b=number, orthogonality=number), radius=number / 4),
    )
    target, schwarz = em.Target(error=number), em.Schwarz(tolerance=number)
    arc: Any = smoothed.monitor
    kept = [least.distortion, least.smoothness, least.obliqueness, arc.a, arc.b, arc.orthogonality]
    kept += [4 * smoothed.radius, em.Curvature(u=U, floor=number).floor, target.error, schwarz.tolerance]
    assert kept == [float(number)] * 10
    assert all(isinstance(one, float) for one in kept)


@pytest.mark.parametrize(
    ("kind", "name", "given"),
    [
        (kind, name, {})
        for kind, names in (
            (em.LeastError, "distortion smoothness obliqueness orthogonality degree rectilinear"),
            (em.ArcLength, "a b scaled orthogonality"),
            (em.Curvature, "isotropic floor orthogonality"),
            (em.Auto, "orthogonality degree"),
        )
        for name in names.split()
    ]
    + [
        (em.Schwarz, name, {})
        for name in ("overlap", "tolerance", "max_iterations", "local_steps", "fallback", "compare_single_domain")
    ]
    + [(em.Smoothed, "radius", {"monitor": em.ArcLength(u=U)}), (em.Target, "error", {}), (em.LinearRobin, "p", {})],
)
def test_infinite_values_and_texts_are_no_settings(kind: Any, name: str, given: dict[str, Any]) -> None:
    function = {"u": U} if any(field.name == "u" for field in dataclasses.fields(kind)) else {}
    for value in (float("inf"), float("nan"), "1", [1]):
        with pytest.raises(em.InputError) as refused:
            kind(**function, **given, **{name: value})
        assert refused.value.field.rpartition(".")[2] == name


def test_a_nan_that_warns_is_refused_as_every_other() -> None:
    signalling = np.array([0x7F86FE86, 0x3F800000], np.uint32).view(np.float32)
    with pytest.raises(em.SamplesError, match=r"u\[0\] is NaN: every sample must be a finite number"):
        real_array(signalling, "u", ndim=1)
