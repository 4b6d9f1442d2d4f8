"""A mesh that follows a function, with the solver alone: no service, no network.

pip install 'equimesh[solver,plot]'
python 01_first_mesh.py
"""

import argparse
from pathlib import Path

import equimesh as em
from equimesh.io import write_mesh
from equimesh.plot import draw_mesh


def main(output: Path) -> None:
    # 1. The function to resolve: a steep front along a wave, from -1 to 1.
    u = em.Expression("tanh(50*(y - 0.5 - 0.25*sin(2*pi*x)))")

    # 2. The strength of the adaptation (a, 0 to 1), the damping where u is steep (b), and the number of points.
    problem = em.Problem(monitor=em.ArcLength(u=u, a=0.7, b=0.05), grid=em.Grid(n_xi=33, n_eta=33))

    # 3. Solve. A mesh that folds raises em.SolveError, so that a returned mesh is always valid.
    solution = em.solve(problem)
    print(solution.message)

    # 4. Its quality.
    quality = solution.quality
    error = quality.interpolation_error
    print(f"smallest corner Jacobian   {quality.min_jacobian:.3f}   (uniform mesh: 1; folded: not positive)")
    print(f"equidistribution, max Q_eq {quality.q_eq.max:.3f}   (1: every cell holds the same arc length of u)")
    print(f"interpolation error, L2    {error.l2:.2e} (uniform mesh: {error.l2_uniform:.2e})")
    print(f"interpolation error, H1    {error.h1:.2e} (uniform mesh: {error.h1_uniform:.2e})")

    # 5. Write it. The coordinates are solution.mesh.x and .y, of shape (33, 33).
    write_mesh(output / "first.vtu", solution.data())
    draw_mesh(solution.data(), output / "first.png")
    print(f"wrote {output / 'first.vtu'} and {output / 'first.png'}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder: Path = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
