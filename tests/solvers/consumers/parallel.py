"""dolfinx reads a mesh on several processes, by file and by arrays: parallel.py XDMF NPZ REPORT, under mpirun."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import ufl
import with_dolfinx as consumer
from dolfinx import fem
from mpi4py import MPI
from run import parts_of

from equimesh_coupling.adaptors.dolfinx import mesh_of


def summary(both: tuple[Any, Any]) -> dict[str, Any]:
    """Sums over all processes: cells, area, lengths of the four sides, and the error of the Poisson problem."""
    mesh, tags = both
    total = mesh.comm.allreduce

    def integral(form: Any) -> float:
        return float(total(fem.assemble_scalar(fem.form(form)), op=MPI.SUM))

    one = fem.Constant(mesh, 1.0)
    along = ufl.ds(domain=mesh, subdomain_data=tags)
    found = {side: integral(one * along(tag)) for tag, side in consumer.SIDES.items()}
    solution = consumer.solve(both)
    exact = consumer.exact(mesh)
    square = (solution - exact) ** 2 * ufl.dx(metadata={"quadrature_degree": 10})
    return {
        "processes": mesh.comm.size,
        "here": total(int(mesh.topology.index_map(2).size_local > 0), op=MPI.SUM),
        "cells": mesh.topology.index_map(2).size_global,
        "area": integral(one * ufl.dx(domain=mesh)),
        "sides": found,
        "error": np.sqrt(integral(square)),
    }


if __name__ == "__main__":
    xdmf, npz, report = sys.argv[1:]
    ways = {"xdmf": summary(consumer.read(xdmf)), "adaptor": summary(mesh_of(parts_of(Path(npz)), MPI.COMM_WORLD))}
    if MPI.COMM_WORLD.rank == 0:
        Path(report).write_text(json.dumps(ways))
