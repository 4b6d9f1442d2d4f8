"""OpenFOAM takes meshes of blocks with their patches, joined ones as cyclic, and measures faces as we do."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

from block_cases import data_of, in_blocks, joined_channel, l_shape
from equimesh.io.write import write_mesh
from equimesh.quality.faces import measure_faces
from solver.quality.handmade import wavy

# Debian's package does not set where OpenFOAM is.
ENVIRONMENT = {"WM_PROJECT_DIR": "/usr/share/openfoam", **os.environ}
DICTIONARIES = {
    "controlDict": "application none; startFrom startTime; startTime 0; endTime 1; deltaT 1; writeInterval 1;",
    "fvSchemes": "gradSchemes { default Gauss linear; }divSchemes { default none; } laplacianSchemes { default none; }",
    "fvSolution": "",
}
MESHES = {"l": l_shape(9), "turned": in_blocks(wavy()).mesh, "channel": joined_channel()}


def check_mesh(case: Path) -> str:
    """What checkMesh prints of the mesh in a case."""
    (case / "system").mkdir()
    for name, text in DICTIONARIES.items():
        head = f"FoamFile {{ version 2.0; format ascii; class dictionary; object {name}; }}"
        (case / "system" / name).write_text(f"{head}\n{text}\n")
    command = ["checkMesh", "-allTopology", "-allGeometry"]
    environment = {**ENVIRONMENT, "PWD": str(case)}
    done = subprocess.run(command, cwd=case, capture_output=True, text=True, timeout=120, env=environment, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


@pytest.mark.needs("openfoam")
@pytest.mark.parametrize("name", MESHES)
def test_check_mesh_passes_and_prints_our_measures(tmp_path: Path, name: str) -> None:
    mesh = MESHES[name]
    write_mesh(tmp_path, data_of(mesh))
    said = check_mesh(tmp_path)
    assert "Mesh OK." in said
    assert "separation" not in said  # a warning about the translation of a cyclic patch
    for side, edges in mesh.sides.items():
        assert re.search(rf"^ *{side.replace(' ', '_')} +{len(edges)} ", said, re.MULTILINE), side
    faces = measure_faces(mesh)
    angles = re.search(r"non-orthogonality Max: (\S+) average: (\S+)", said)
    skewness = re.search(r"Max skewness = (\S+)", said)
    assert angles
    assert skewness
    expected = faces.non_orthogonality, faces.mean_non_orthogonality, faces.skewness
    assert (float(angles[1]), float(angles[2]), float(skewness[1])) == pytest.approx(expected, rel=1e-5)
