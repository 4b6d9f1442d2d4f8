"""A wavy front that travels to the right, and the mesh that follows it: a moving picture, as an SVG.

pip install 'equimesh[solver]'
python 21_front_in_time.py --output ../docs/images
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import equimesh as em

POINTS = 33
"""Points of the mesh in each direction."""
FRAMES = 20
"""Meshes in one period of the motion; the viewer moves the lines evenly between them."""
SECONDS = 8
"""The time that one period takes in the picture."""
SIDE = 640
"""The unit square in units of the picture."""
WIDTH = 0.025
"""Half the width of the front in the picture: there u is between -0.76 and 0.76."""
U = "tanh(40*(y - 0.5 - 0.1*sin(2*pi*(x - {t}))))"

PAGE = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="-4 -4 {size} {size}" role="img" aria-label="{title}">
<title>{title}</title>
<style>.still {{ display: none }}
@media (prefers-reduced-motion: reduce) {{ .moving {{ display: none }} .still {{ display: inline }} }}</style>
<rect x="-4" y="-4" width="{size}" height="{size}" fill="#ffffff"/>
<g stroke-linejoin="round">
{paths}
</g>
</svg>
"""
TITLE = "A mesh that follows a travelling front"


def monitor(t: float) -> em.Monitor:
    """The curvature of u at time t, smoothed, so that cells keep their shapes."""
    return em.Smoothed(monitor=em.Curvature(u=em.Expression(U.format(t=round(t, 6)))), radius=0.02)


def follow() -> list[em.Solution]:
    """The meshes of one period; each solve begins with the mesh before."""
    first = em.Problem(monitor=monitor(0.0), grid=em.Grid(n_xi=POINTS, n_eta=POINTS))
    sequence = em.Sequence(first)
    return [sequence.step(monitor(k / FRAMES)).solution for k in range(FRAMES)]


def path(lines: Sequence[np.ndarray]) -> str:
    """Polylines as one path in whole units: where each begins, then its steps."""
    parts = []
    for line in lines:
        x, y = np.rint(SIDE * line.T).astype(int)
        y = SIDE - y
        steps = "".join(f"{dx} {dy} " for dx, dy in zip(np.diff(x), np.diff(y), strict=True))
        parts.append(f"M{x[0]} {y[0]}l{steps.strip()}".replace(" -", "-"))
    return "".join(parts)


def mesh_lines(mesh: em.Mesh) -> list[np.ndarray]:
    """All lines of the mesh, each of shape (points, 2)."""
    return [np.column_stack(p) for a, b in ((mesh.x, mesh.y), (mesh.x.T, mesh.y.T)) for p in zip(a, b, strict=True)]


def front(t: float) -> list[np.ndarray]:
    """The edge of the band in which u changes, at time t."""
    x = np.linspace(0.0, 1.0, 65)
    middle = 0.5 + 0.1 * np.sin(2 * np.pi * (x - t))
    upper, lower = np.column_stack([x, middle + WIDTH]), np.column_stack([x, middle - WIDTH])
    return [np.concatenate([upper, lower[::-1]])]


def moving(paths: Sequence[str], style: str) -> str:
    """One shape that moves through ``paths`` and back to the first, and one that stands still, for who wants that."""
    values = ";".join([*paths, paths[0]])
    motion = f'<animate attributeName="d" dur="{SECONDS}s" repeatCount="indefinite" values="{values}"/>'
    return f'<path class="moving" d="{paths[0]}" {style}>{motion}</path>\n<path class="still" d="{paths[0]}" {style}/>'


def main(output: Path) -> None:
    solutions = follow()
    bands = [path(front(k / FRAMES)) + "z" for k in range(FRAMES)]
    meshes = [path(mesh_lines(solution.mesh)) for solution in solutions]
    paths = [moving(bands, 'fill="#fd8d3c"'), moving(meshes, 'fill="none" stroke="#22323f" stroke-width="0.9"')]
    file = output / "front-in-time.svg"
    file.write_text(PAGE.format(size=SIDE + 8, title=TITLE, paths="\n".join(paths)))
    gains = [solution.certificate.interpolation.gain_l2 for solution in solutions]
    print(f"wrote {file}, {file.stat().st_size / 1000:.0f} kB")
    print(f"error {min(gains):.1f} to {max(gains):.1f} times smaller than on the uniform mesh of {POINTS} x {POINTS}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder: Path = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
