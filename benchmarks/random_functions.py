"""Random functions of x and y from a seed, to measure on what nobody tuned to.

Tune on some seeds, and report the numbers of others. Every function is an expression on the unit square. Its kind is
drawn first, then its place, its direction and its steepness:

- ``front``: a straight front in any direction; ``upright`` and ``level``: one along a coordinate line;
- ``ring``: a closed front around an ellipse; ``star``: a closed front that bends both ways;
- ``wave``: a bent front across the square; ``arc``: a bent front that meets two sides;
- ``peak``: a hill in the inside; ``layer``: boundary layers along one or two sides;
- ``ripple``: a smooth wave with few periods; ``sum``: two or three of these, with weights.

    python benchmarks/random_functions.py --seed 1 --count 20
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

# The slope of fronts, per unit of length: drawn between these, the same number for each factor.
MIN_STEEPNESS, MAX_STEEPNESS = 8.0, 100.0
# The terms of a sum.
MIN_TERMS, MAX_TERMS = 2, 3
# Every so many functions are sums, on average.
SUMS_EVERY = 2


class RandomFunction(NamedTuple):
    """A kind and an expression of x and y."""

    kind: str
    u: str


def random_functions(seed: int, count: int) -> list[RandomFunction]:
    """``count`` functions of all kinds. The first ones are the same for every count."""
    return [_function(np.random.default_rng((seed, number))) for number in range(count)]


def _function(rng: np.random.Generator) -> RandomFunction:
    if rng.integers(SUMS_EVERY) == 0:
        terms = [_single(rng) for _ in range(rng.integers(MIN_TERMS, MAX_TERMS + 1))]
        weights = [1.0, *rng.uniform(0.3, 1.0, len(terms) - 1)]
        return RandomFunction("sum", " + ".join(f"{w:.2f}*({t.u})" for w, t in zip(weights, terms, strict=True)))
    return _single(rng)


def _single(rng: np.random.Generator) -> RandomFunction:
    kind = str(rng.choice(list(KINDS)))
    return RandomFunction(kind, KINDS[kind](rng))


def _steepness(rng: np.random.Generator, share: float = 1.0) -> str:
    """A slope for a front; its greatest is ``share`` of the greatest of all."""
    return f"{np.exp(rng.uniform(np.log(MIN_STEEPNESS), np.log(share * MAX_STEEPNESS))):.1f}"


def _inside(rng: np.random.Generator, margin: float) -> tuple[str, str]:
    """A coordinate each along x and y, at least ``margin`` from the sides."""
    x, y = rng.uniform(margin, 1.0 - margin, 2)
    return f"{x:.3f}", f"{y:.3f}"


def _front(rng: np.random.Generator) -> str:
    (x, y), angle = _inside(rng, 0.2), rng.uniform(0.0, np.pi)
    return f"tanh({_steepness(rng)}*({np.cos(angle):.4f}*(x - {x}) + {np.sin(angle):.4f}*(y - {y})))"


def _upright(rng: np.random.Generator) -> str:
    return f"tanh({_steepness(rng)}*(x - {rng.uniform(0.15, 0.85):.3f}))"


def _level(rng: np.random.Generator) -> str:
    return f"tanh({_steepness(rng)}*(y - {rng.uniform(0.15, 0.85):.3f}))"


def _ring(rng: np.random.Generator) -> str:
    (x, y), radius, flatness = _inside(rng, 0.4), rng.uniform(0.15, 0.35), rng.uniform(0.7, 1.4)
    return f"tanh({_steepness(rng)}*(sqrt((x - {x})**2 + {flatness:.2f}*(y - {y})**2 + 1e-4) - {radius:.3f}))"


def _star(rng: np.random.Generator) -> str:
    (x, y), radius, arms = _inside(rng, 0.45), rng.uniform(0.2, 0.3), rng.integers(3, 7)
    x, y = f"{x}1", f"{y}1"  # no node of a usual grid: the angle has a pole there
    bend = f"{radius:.3f} - {radius * rng.uniform(0.1, 0.3):.3f}*cos({arms}*atan2(y - {y}, x - {x}))"
    return f"tanh({_steepness(rng, 0.6)}*(sqrt((x - {x})**2 + (y - {y})**2 + 1e-4) - {bend}))"


def _wave(rng: np.random.Generator) -> str:
    along, across = ("x", "y") if rng.integers(2) else ("y", "x")
    height, level, phase = rng.uniform(0.05, 0.25), rng.uniform(0.35, 0.65), rng.uniform(0.0, 2.0)
    periods = rng.uniform(0.5, 2.0)
    bent = f"{level:.3f} - {height:.3f}*sin(pi*({2.0 * periods:.2f}*{along} + {phase:.2f}))"
    return f"tanh({_steepness(rng)}*({across} - {bent}))"


def _arc(rng: np.random.Generator) -> str:
    x, y = f"{rng.integers(2)}", f"{rng.integers(2)}"
    return f"tanh({_steepness(rng)}*(sqrt((x - {x})**2 + (y - {y})**2 + 1e-4) - {rng.uniform(0.4, 0.9):.3f}))"


def _peak(rng: np.random.Generator) -> str:
    (x, y), slope, flatness = _inside(rng, 0.25), np.exp(rng.uniform(np.log(20.0), np.log(200.0))), rng.uniform(0.5, 2)
    square = f"((x - {x})**2 + {flatness:.2f}*(y - {y})**2)"
    return f"exp(-{slope:.1f}*{square})" if rng.integers(2) else f"1/(1 + {slope:.1f}*{square})"


def _layer(rng: np.random.Generator) -> str:
    sides = [str(side) for side in rng.permutation(["x", "(1 - x)", "y", "(1 - y)"])[: rng.integers(1, 3)]]
    return " + ".join(f"exp(-{_steepness(rng)}*{side})" for side in sides)


def _ripple(rng: np.random.Generator) -> str:
    (p, q), (r, s) = rng.uniform(0.5, 3.0, 2), rng.uniform(0.0, 2.0, 2)
    return f"sin(pi*({p:.2f}*x + {r:.2f})) * sin(pi*({q:.2f}*y + {s:.2f}))"


KINDS: dict[str, Callable[[np.random.Generator], str]] = {
    "front": _front,
    "upright": _upright,
    "level": _level,
    "ring": _ring,
    "star": _star,
    "wave": _wave,
    "arc": _arc,
    "peak": _peak,
    "layer": _layer,
    "ripple": _ripple,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=20)
    arguments = parser.parse_args()
    for kind, u in random_functions(arguments.seed, arguments.count):
        print(f"{kind:8} {u}")


if __name__ == "__main__":
    main()
