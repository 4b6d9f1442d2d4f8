"""Haynes and Howse, Figures 4 and 5: how classical Schwarz converges, by component and by overlap.

12 x 12 points, a = 0.7, b = 0.05, from the uniform mesh; both subdomains read the previous iteration, as in the paper.

    pip install 'equimesh[solver,plot]'
    python 07_paper_classical.py
"""

import argparse
from pathlib import Path

import equimesh as em
from equimesh.plot import draw_histories

PAPER = em.Problem(
    monitor=em.ArcLength(u=em.Expression("(1 - exp(15*(x - 1))) * sin(pi*y)"), a=0.7, b=0.05, scaled=False),
    grid=em.Grid(n_xi=12, n_eta=12),
    boundary=em.Boundary.EQUIDISTRIBUTED_1D,
)


def classical(overlap: int, iterations: int) -> em.Solution:
    """Classical Schwarz on two strips, with the error of every iteration against the single-domain mesh."""
    settings = em.Schwarz(
        overlap=overlap,
        transmission=em.Classical(),
        ordering=em.Ordering.PARALLEL,
        tolerance=None,
        max_iterations=iterations,
        compare_single_domain=True,
    )
    return em.solve(PAPER, settings, initial=em.Initial.UNIFORM)


def errors(solution: em.Solution, subdomain: int, component: str) -> list[float]:
    """Largest error of x or y in a subdomain, iteration by iteration."""
    return [getattr(record.subdomains[subdomain], f"error_{component}") for record in solution.iterations]


def rate(history: list[float]) -> float:
    """Mean factor by which the error falls in one iteration, without the first iterations and rounding."""
    usable = [error for error in history if error > 1e-10][2:]
    return (usable[-1] / usable[0]) ** (1 / (len(usable) - 1))


def main(output: Path) -> None:
    solution = classical(overlap=4, iterations=30)
    components = {f"${c}_{s + 1}^n$": errors(solution, s, c) for c in "xy" for s in (0, 1)}
    title = "Classical Schwarz, 4 points of overlap: the parts of the solution"
    draw_histories(components, output / "figure4.png", title=title, ylabel="largest error")
    found = ", ".join(f"{label.strip('$')[:3]} {rate(history):.3f}" for label, history in components.items())
    print(f"figure4.png  error per iteration falls by {found}")
    print("             paper: all components converge at about the same rate; the same here")

    print("figure5.png  overlap   rate of x_1   predicted")
    overlaps = {}
    for overlap in (2, 4, 6, 8):
        solution = classical(overlap, iterations=24)
        overlaps[f"{overlap} points"] = history = [e for e in errors(solution, 0, "x") if e > 1e-11]
        print(f"             {overlap:>7}   {rate(history):11.3f}   {solution.predicted_rate:9.3f}")
    print("             paper: the rate improves as the overlap increases; the same here")
    title = "Classical Schwarz: points of overlap"
    draw_histories(overlaps, output / "figure5.png", title=title, ylabel="largest error of $x_1^n$")
    print(f"wrote figure4.png and figure5.png to {output}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder: Path = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
