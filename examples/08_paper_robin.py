"""Haynes and Howse, Figures 6 to 8: the parameter p of the linear and of the nonlinear Robin condition.

12 x 12 points, a = 0.7, b = 0.05, two strips with 2 points of overlap, from the uniform mesh; subdomain 2 reads the
newest subdomain 1, as in Table 1.

    pip install 'equimesh[solver,plot]'
    python 08_paper_robin.py
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
WHOLE = (1, 2, 3, 4, 5)
CLOSED_FORM = 11 / 5  # one over the distance from an interface to the side beyond it, 1 / (1 - beta) = 1 / alpha


def history(transmission: em.TransmissionCondition) -> list[float]:
    """Largest error of x_1, iteration by iteration, down to rounding."""
    settings = em.Schwarz(
        overlap=2,
        transmission=transmission,
        ordering=em.Ordering.ALTERNATING,
        tolerance=None,
        max_iterations=8,
        compare_single_domain=True,
    )
    solution = em.solve(PAPER, settings, initial=em.Initial.UNIFORM)
    return [error for record in solution.iterations if (error := record.subdomains[0].error_x) > 1e-12]


def draw(histories: dict[str, list[float]], path: Path, title: str) -> None:
    draw_histories(histories, path, title=title, ylabel="largest error of $x_1^n$")


def main(output: Path) -> None:
    sweep = sorted((*WHOLE, CLOSED_FORM))
    linear = {p: history(em.LinearRobin(p=p)) for p in sweep}
    nonlinear = {p: history(em.NonlinearRobin(p=p)) for p in sweep}
    draw({f"p = {p:g}": linear[p] for p in sweep}, output / "figure6.png", "Linear Robin conditions")
    draw({f"p = {p:g}": nonlinear[p] for p in sweep}, output / "figure7.png", "Nonlinear Robin conditions")
    both = {}
    for p in (1, 2, 3):
        both |= {f"linear, p = {p}": linear[p], f"nonlinear, p = {p}": nonlinear[p]}
    draw(both, output / "figure8.png", "Linear and nonlinear Robin conditions")

    print("error of x_1 after 4 iterations\n  p     linear  nonlinear")
    for p in sweep:
        print(f"{p:>3g}  {linear[p][4]:>9.1e}  {nonlinear[p][4]:>9.1e}")
    best = [min(WHOLE, key=lambda p, found=found: found[p][4]) for found in (linear, nonlinear)]
    print(f"figure6.png, figure7.png: the best whole p is {best[0]} (linear), {best[1]} (nonlinear)")
    print("  paper: p = 2 for both; the same here, and the closed form p = 11/5 is better still")
    better = [f"{p:g}" for p in sweep if nonlinear[p][4] < linear[p][4]]
    worse = [f"{p:g}" for p in sweep if nonlinear[p][4] > linear[p][4]]
    print(f"figure8.png: nonlinear is better for p = {', '.join(better)}, linear for p = {', '.join(worse)}")
    print("  paper: nonlinear is consistently better for p = 1, 2, 3; here it is not for p = 3. Differences are small")
    print(f"wrote figure6.png, figure7.png and figure8.png to {output}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder: Path = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
