"""The wake of a cylinder at Re = 100 by FreeFEM, on a mesh that follows it; errors against a fine mesh.

    pip install 'equimesh[solver,plot]'
    python cylinder.py

The program cylinder.edp next to this one computes some steps of time on a mesh of triangles. After every few steps an
equimesh.Sequence moves the nodes to the velocity along the channel, and FreeFEM interpolates the flow to the new
mesh. All meshes begin with the same flow, that of the fine mesh, and compute one period of the wake.
"""

import argparse
import os
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

import equimesh as em
from equimesh.io import write_mesh

PROGRAM = Path(__file__).with_suffix(".edp")
ENVIRONMENT = {"FF_LOADPATH": "/usr/lib/freefem++", **os.environ}
LIFT = re.compile(r"lift (\S+)")
DT, EVERY = 0.05, 5  # the length of a step, and the steps on one mesh
# 0.5 has 624 cells. Steps until vortices leave the cylinder, further ones on the fine mesh, and those compared:
DEFAULTS = {"refine": 0.5, "fine": 2.0, "settling": 600, "matching": 100, "period": 90}
XS, YS = (-2.5, -1, 1, 8), (-2, -1, 1, 2)
AROUND = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
DIAGONALS = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
QUARTERS = [(0, 1), (1, 2), (2, 3), (3, 0)]


def channel(refine: float = 1) -> em.Blocks:
    """A cylinder of diameter 1 in a channel of height 4: four blocks around it, and eight to the walls."""
    square, across, up = ["p11", "p21", "p22", "p12"], (10, 16, 40), (8, 16, 8)
    blocks = [
        {"corners": [f"c{a}", square[a], square[b], f"c{b}"], "cells": [10, 16], "grading": [4, None]}
        for a, b in QUARTERS
    ]
    for i, j in AROUND:
        four = [f"p{i}{j}", f"p{i + 1}{j}", f"p{i + 1}{j + 1}", f"p{i}{j + 1}"]
        blocks.append({"corners": four, "cells": [across[i], up[j]]})
    return em.Blocks.of(
        {
            "vertices": {f"p{i}{j}": [x, y] for i, x in enumerate(XS) for j, y in enumerate(YS)}
            | {f"c{k}": [x / 8**0.5, y / 8**0.5] for k, (x, y) in enumerate(DIAGONALS)},
            "curves": {"cylinder": {"circle": {"radius": 0.5}}},
            "edges": [{"from": f"c{a}", "to": f"c{b}", "on": "cylinder"} for a, b in QUARTERS],
            "blocks": blocks,
            "sides": {
                **{name: [[f"p{i}{j}", f"p{i}{j + 1}"] for j in range(3)] for name, i in (("inlet", 0), ("outlet", 3))},
                **{name: [[f"p{i}{j}", f"p{i + 1}{j}"] for i in range(3)] for name, j in (("bottom", 0), ("top", 3))},
                "cylinder": [[f"c{a}", f"c{b}"] for a, b in QUARTERS],
            },
            "refine": refine,
        }
    )


@dataclass(frozen=True)
class Flows:
    """Flows in files of a folder, each with a name and its mesh."""

    folder: Path

    def run(self, name: str, mesh: em.Mesh, before: str = "", steps: int = 0, fine: str = "") -> str:
        """What FreeFEM prints for some steps on a mesh, from the flow ``before``; the result is the flow ``name``."""
        count = len(mesh.cells)
        data = em.MeshData(mesh=mesh, u=None, q_eq=np.zeros(count), subdomain=np.zeros(count, dtype=int))
        write_mesh(self.folder / f"{name}.mesh", data, cells="triangle")
        command = f"FreeFem++-nw -ne -v 0 {PROGRAM} -mesh {name} -steps {steps} -dt {DT}".split()
        command += ["-before", before] * (before != "") + ["-fine", fine] * (fine != "")
        done = subprocess.run(command, cwd=self.folder, env=ENVIRONMENT, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(done.stdout + done.stderr)
        return done.stdout

    def velocity(self, name: str, mesh: em.Mesh) -> em.QuadField:
        """The velocity of a flow along the channel."""
        return em.QuadField(mesh=mesh, values=np.loadtxt(self.folder / f"{name}.uv")[:, 0])

    def follow(self, domain: em.Blocks, period: int) -> tuple[str, em.Mesh]:
        """What FreeFEM prints on meshes that follow the flow from ``begin`` on, and the last of them."""
        self.run("moved", domain.mesh, "begin")
        monitor = em.LeastError(u=self.velocity("moved", domain.mesh), distortion=4, smoothness=4)
        sequence = em.Sequence(em.Problem(monitor=monitor, domain=domain), mesh=domain.mesh, check=False)
        said, before, name = "", "begin", "moved"  # the first mesh takes the flow of the fine mesh itself
        for number in range(EVERY, period + 1, EVERY):
            mesh = sequence.step(self.velocity(name, sequence.mesh)).mesh
            name = f"moved{number}"
            said += self.run(name, mesh, before, EVERY, "fine" if number == period else "")
            before = name
        return said, sequence.mesh


def draw(meshes: list[em.Mesh], speed: em.QuadField, path: Path) -> None:
    figure = Figure(figsize=(9, 7), layout="constrained")
    for axes, mesh, title in zip(figure.subplots(2, 1), meshes, ("initial", "after one period"), strict=True):
        values = speed.evaluate(*mesh.points[mesh.cells].mean(axis=1).T)[0]
        cells = PolyCollection(mesh.points[mesh.cells], array=values, cmap="coolwarm", edgecolor="0.2", linewidth=0.3)
        axes.add_collection(cells)
        axes.set(title=title, aspect="equal", xlim=(XS[0], XS[-1]), ylim=(YS[0], YS[-1]))
    figure.savefig(path, dpi=80)


def main(output: Path, refine: float, fine: float, settling: int, matching: int, period: int) -> None:
    flows, domain, finest = Flows(output), channel(refine), channel(fine).mesh
    flows.run("settled", channel(0.5).mesh, steps=settling)
    flows.run("begin", finest, "settled", matching)
    lift = np.array(LIFT.findall(flows.run("fine", finest, "begin", period)), float)
    print(f"reference of {len(finest.cells)} cells: lift from {lift.min():.3f} to {lift.max():.3f}")
    said = {"initial": flows.run("initial", domain.mesh, "begin", period, "fine")}
    said["moved"], mesh = flows.follow(domain, period)
    for name, text in said.items():
        wrong = np.sqrt(np.mean((np.array(LIFT.findall(text), float) - lift) ** 2))
        error = float(text.split("error")[1])
        print(f"{name}: {len(mesh.cells)} cells, error of the velocity {error:.3e}, of the lift {wrong:.3e}")
    draw([domain.mesh, mesh], flows.velocity("fine", finest), output / "cylinder-wake.png")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    for name, value in DEFAULTS.items():
        parser.add_argument(f"--{name}", type=type(value), default=value)
    given = vars(parser.parse_args())
    given["output"].mkdir(parents=True, exist_ok=True)
    main(**given)
