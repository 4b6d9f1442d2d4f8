"""The kit of monitors: the project's own monitors pass it, and it refuses each broken promise."""

from __future__ import annotations

import pickle
import subprocess
import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest

import equimesh as em
from equimesh.testing import check_monitor

STEEP = em.Expression("tanh(20*(x + y/2 - 0.75))")
WAVE = em.Expression("tanh(50*(y - 0.5 - 0.25*sin(2*pi*x)))")
ARC = em.ArcLength(u=STEEP, a=0.9, b=0.01)
AXIS = np.linspace(0.0, 1.0, 21)
SAMPLES = em.GridSamples(x=AXIS, y=AXIS, values=np.sin(4 * AXIS)[:, None] * np.cos(3 * AXIS))
NODES = em.Mesh.uniform(em.Grid(n_xi=17, n_eta=17))
NODAL = em.NodalField(mesh=NODES, values=np.tanh(5 * (NODES.x - NODES.y)))
MONITORS: dict[str, em.Monitor] = {
    "arc length": ARC,
    "arc length of samples": em.ArcLength(u=SAMPLES),
    "curvature l2": em.Curvature(u=STEEP),
    "curvature h1": em.Curvature(u=STEEP, norm="h1"),
    "isotropic": em.Curvature(u=STEEP, isotropic=True),
    "weight": em.Weight(rho=em.Expression("1 + 9*exp(-20*(x - y)**2)"), u=WAVE),
    "gradient map": em.Weight(rho=em.Expression("1 + 9*exp(-20*(x - y)**2)"), map="gradient"),
    "tensor": em.Tensor(m11=em.Expression("2 + x**2"), m12=em.Expression("sin(x*y)"), m22=em.Expression("3")),
    "intersection": em.Intersection(monitors=(ARC, em.Curvature(u=WAVE))),
    "smoothed": em.Smoothed(monitor=ARC, radius=0.04),
    "least error": em.LeastError(u=STEEP),
    "least error h1 of samples": em.LeastError(u=SAMPLES, norm="h1"),
    "auto": em.Auto(u=STEEP),
    "round from samples": em.NodalSolution(u=NODAL),
    "weakened": em.Curvature(u=WAVE).weakened(0.3),
}


@pytest.mark.parametrize("name", MONITORS)
def test_own_monitors_pass(name: str) -> None:
    check_monitor(MONITORS[name])


@pytest.mark.parametrize("name", [name for name in MONITORS if "samples" not in name])
def test_own_monitors_pass_on_another_domain(name: str) -> None:
    ring = em.AnnulusSector(center=(0.3, 0.2), radii=(0.5, 1.0), angles=(20.0, 110.0))
    check_monitor(MONITORS[name], domain=ring)


def test_bound_monitors_have_the_same_metric_in_another_process() -> None:
    x, y = np.array([0.1, 0.52, 0.9]), np.array([0.3, 0.47, 0.8])
    bound = [one.on(em.Rectangle()) for one in MONITORS.values()]
    program = (
        "import pickle, sys; bound, x, y = pickle.load(sys.stdin.buffer);"
        " sys.stdout.buffer.write(pickle.dumps([one.metric(x, y) for one in bound]))"
    )
    sent = pickle.dumps((bound, x, y))
    there = subprocess.run([sys.executable, "-c", program], input=sent, check=True, stdout=subprocess.PIPE).stdout
    for one, metric in zip(bound, pickle.loads(there), strict=True):
        assert all(np.array_equal(here, other) for here, other in zip(one.metric(x, y), metric, strict=True))


@dataclass(frozen=True)
class Ripple:
    """A right monitor: the isotropic metric ``1 + strength cos(9 x)^2``."""

    strength: float = 3.0
    u: em.Field | None = None

    def metric(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        m = 1.0 + self.strength * np.cos(9 * x) ** 2 + 0 * y
        return m, 0 * m, m

    def on(self, domain: em.Domain) -> Ripple:  # noqa: ARG002
        return self

    def weakened(self, strength: float) -> Ripple:
        return replace(self, strength=strength * self.strength)


class Flat(Ripple):
    def metric(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[override]
        return super().metric(x, y)[:2]


class Indefinite(Ripple):
    def metric(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        m, _, _ = super().metric(x, y)
        return m, 1.2 * m, m


class Inside(Ripple):
    def metric(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        m, zero, _ = super().metric(x, y)
        return m, zero, np.where((x < 0.0) | (x > 1.0), np.nan, m)


class Rebound(Ripple):
    def on(self, domain: em.Domain) -> Ripple:  # noqa: ARG002
        return replace(self, strength=self.strength + 1.0)


class Unpicklable(Ripple):
    def __reduce__(self) -> tuple[object, ...]:
        raise TypeError("not this one")


class Forgetful(Ripple):
    def __reduce__(self) -> tuple[object, ...]:
        return Ripple, ()


class Halved(Ripple):
    def weakened(self, strength: float) -> Ripple:
        return replace(self, strength=0.5 * strength * self.strength)


class Stubborn(Ripple):
    def weakened(self, strength: float) -> Ripple:
        return replace(self, strength=(0.1 + 0.9 * strength) * self.strength)


class Jumping(Ripple):
    def weakened(self, strength: float) -> Ripple:
        return replace(self, strength=(strength > 0.5) * self.strength)


class Returning(Ripple):
    """Unbound by weakening, and as strong as ever when bound again."""

    def weakened(self, strength: float) -> Ripple:
        return super().weakened(strength) if strength else Unbound(0.0)


class Unbound(Ripple):
    def on(self, domain: em.Domain) -> Ripple:  # noqa: ARG002
        return Ripple()


@pytest.mark.parametrize(
    ("monitor", "sentence"),
    [
        (Flat(), r"must return the tuple \(m11, m12, m22\), not 2 values"),
        (Indefinite(), "is not positive definite at .*: its smallest eigenvalue is -"),
        (Inside(), r"m22 is not finite at \(-1e-05"),
        (Ripple(u=3.0), "u must be a field, with a method evaluate, or None; it is a float"),  # type: ignore[arg-type]
        (Rebound(), r"on\(domain\) of a bound monitor changes the metric: m11 differs by"),
        (Unpicklable(), "cannot be pickled: not this one"),
        (Forgetful(strength=2.0), "the metric changes by pickling"),
        (Halved(), r"weakened\(1\) is not the monitor itself"),
        (Stubborn(), r"the metric of weakened\(0\) is not constant"),
        (Jumping(), r"m11 jumps by .* where the strength changes by 1e-4"),
        (Returning(), r"the mesh of weakened\(0\) is not uniform: nodes are .* away"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Ripple) else "",
)
def test_broken_promises_are_refused(monitor: em.Monitor, sentence: str) -> None:
    check_monitor(Ripple())
    with pytest.raises(AssertionError, match=sentence):
        check_monitor(monitor)


def test_a_monitor_without_u_is_refused() -> None:
    class Blind:
        metric, on, weakened = Ripple().metric, lambda self, domain: self, Ripple().weakened  # noqa: ARG005

    with pytest.raises(AssertionError, match="u is missing"):
        check_monitor(Blind())  # type: ignore[arg-type]
