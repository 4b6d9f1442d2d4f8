"""Haynes and Howse, Figures 1 to 3: the decomposition, the mesh of 18 x 18 points, and u on it.

pip install 'equimesh[solver,plot]'
python 06_paper_mesh.py
"""

import argparse
from pathlib import Path

import equimesh as em
from equimesh.plot import draw_decomposition, draw_mesh, draw_surface

# The paper: 18 x 18 points, a = 0.7, b = 0.05, two subdomains with 4 points of overlap in xi, linear Robin, p = 2.3.
PAPER = em.Problem(
    monitor=em.ArcLength(u=em.Expression("(1 - exp(15*(x - 1))) * sin(pi*y)"), a=0.7, b=0.05, scaled=False),
    grid=em.Grid(n_xi=18, n_eta=18),
    boundary=em.Boundary.EQUIDISTRIBUTED_1D,
)
SCHWARZ = em.Schwarz(overlap=4, transmission=em.LinearRobin(p=2.3), ordering=em.Ordering.ALTERNATING)


def main(output: Path) -> None:
    solution = em.solve(PAPER, SCHWARZ, initial=em.Initial.UNIFORM)
    single = em.solve(PAPER, mode="tight").mesh
    distance = max(abs(solution.mesh.x - single.x).max(), abs(solution.mesh.y - single.y).max())
    print(f"{len(solution.iterations) - 1} Schwarz iterations from the uniform mesh")
    print(f"largest distance to the mesh of a single domain: {distance:.1e}")
    print(f"max Q_eq {solution.quality.q_eq.max:.4f}, smallest corner Jacobian {solution.mesh.min_jacobian:.3f}")

    draw_decomposition(SCHWARZ.decompose(PAPER.grid), output / "figure1.png")
    draw_mesh(solution.data(), output / "figure2.png", decomposition=solution.decomposition)
    draw_surface(solution.data(), output / "figure3.png")
    print("figure1.png  the two subdomains, [0, beta] and [alpha, 1] in xi")
    print("figure2.png  the mesh: subdomain 1 red, subdomain 2 blue, the overlap purple")
    print("figure3.png  u on the mesh: its points gather where u falls to zero, at the right side")
    print(f"wrote the figures to {output}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder: Path = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
