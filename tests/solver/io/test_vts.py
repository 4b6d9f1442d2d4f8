"""VTS files: the text itself, since meshio reads no structured grids; VTK and ParaView read them in tests/solvers."""

from __future__ import annotations

import base64
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np

from equimesh.io.write import write_mesh
from solver.io.files import DATA, N_ETA, N_XI, written

NUMBERS = {"Float64": "<f8", "Int32": "<i4"}


def arrays_of(section: ET.Element | None) -> dict[str, np.ndarray]:
    """The arrays of a section; each is the count of its bytes in 64 bits, and the bytes."""
    assert section is not None
    found = {}
    for array in section:
        data = base64.b64decode(array.text or "")
        assert int.from_bytes(data[:8], "little") == len(data) - 8
        found[array.attrib["Name"]] = np.frombuffer(data[8:], NUMBERS[array.attrib["type"]])
    return found


def test_rows_run_along_xi(tmp_path: Path) -> None:
    root = ET.parse(written(tmp_path, "vts", "quad")).getroot()
    assert root.attrib["type"] == "StructuredGrid"
    grid = root.find("StructuredGrid")
    piece = root.find("StructuredGrid/Piece")
    assert grid is not None
    assert piece is not None
    extent = f"0 {N_XI - 1} 0 {N_ETA - 1} 0 0"
    assert (grid.attrib["WholeExtent"], piece.attrib["Extent"]) == (extent, extent)
    points = arrays_of(piece.find("Points"))["Points"].reshape(N_ETA, N_XI, 3)
    np.testing.assert_array_equal(points[:, :, 0], DATA.mesh.x.T)
    np.testing.assert_array_equal(points[:, :, 1], DATA.mesh.y.T)
    assert np.all(points[:, :, 2] == 0)
    nodes, cells = arrays_of(piece.find("PointData")), arrays_of(piece.find("CellData"))
    xi, eta = DATA.computational
    assert DATA.u is not None
    for name, values in {"u": DATA.u, "xi": xi, "eta": eta}.items():
        np.testing.assert_array_equal(nodes[name].reshape(N_ETA, N_XI), values.T)
    for name, values in {"Q_eq": DATA.q_eq, "subdomain": DATA.subdomain}.items():
        np.testing.assert_array_equal(cells[name].reshape(N_ETA - 1, N_XI - 1), values.T)
    assert (sorted(nodes), sorted(cells)) == (["eta", "u", "xi"], ["Q_eq", "subdomain"])


def test_vectors_follow_their_points(tmp_path: Path) -> None:
    x = DATA.mesh.x
    data = replace(DATA, fields={"v": np.stack([x, 2 * x], axis=-1)}, cell_fields={"rho": DATA.q_eq})
    piece = ET.parse(write_mesh(tmp_path / "mesh.vts", data)[0]).getroot().find("StructuredGrid/Piece")
    assert piece is not None
    vectors = arrays_of(piece.find("PointData"))["v"].reshape(N_ETA, N_XI, 3)
    np.testing.assert_array_equal(vectors, np.stack([x.T, 2 * x.T, 0 * x.T], axis=-1))
    np.testing.assert_array_equal(arrays_of(piece.find("CellData"))["rho"].reshape(N_ETA - 1, N_XI - 1), DATA.q_eq.T)
