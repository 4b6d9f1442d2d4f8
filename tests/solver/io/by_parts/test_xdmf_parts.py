"""HDF5 parts with an XDMF head: h5py reads the head as one file, and the text names its datasets."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import h5py
import numpy as np
import pytest

from equimesh.io.by_parts.xdmf_parts import side_edges
from solver.io.by_parts.parted import ARRAYS, CUTS, DATA, N_ETA, N_XI, subdomains, written


@pytest.mark.parametrize("cuts", CUTS, ids=str)
def test_h5py_reads_the_head_as_one_file(tmp_path: Path, cuts: tuple[int, ...]) -> None:
    head = written(tmp_path, "xdmf", cuts)
    with h5py.File(head.with_suffix(".h5")) as file:
        for name, values in {**ARRAYS, "subdomain": subdomains(cuts)}.items():
            np.testing.assert_array_equal(file[name][:], values)
        for side, edges in DATA.mesh.sides.items():
            np.testing.assert_array_equal(file[f"sides/{side}"][:], edges)
    own = []
    for path in sorted((tmp_path / "mesh").iterdir()):
        with h5py.File(path) as file:
            own.append(file["x"].size)
    assert sum(own) == N_XI * N_ETA  # no node twice


def test_the_text_refers_to_the_datasets(tmp_path: Path) -> None:
    head = written(tmp_path, "xdmf", CUTS[1])
    root = ET.parse(head).getroot()
    with h5py.File(head.with_suffix(".h5")) as file:
        for item in root.iter("DataItem"):
            name, _, dataset = (item.text or "").partition(":/")
            assert name == "mesh.h5"
            assert item.attrib["Dimensions"] == " ".join(map(str, file[dataset].shape))
            assert item.attrib["Precision"] == str(file[dataset].dtype.itemsize)
    centers = {item.attrib["Name"]: item.attrib["Center"] for item in root.iter("Attribute")}
    assert centers == {"u": "Node", "v": "Node", "Q_eq": "Cell", "subdomain": "Cell"}


def test_edges_are_those_of_the_mesh() -> None:
    for side, edges in side_edges(DATA.mesh.grid).items():
        np.testing.assert_array_equal(edges, DATA.mesh.sides[side])
