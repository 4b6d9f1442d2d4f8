"""HDF5 files in parts: a ``.h5`` file for every part, a ``.h5`` head of virtual datasets, and an ``.xdmf`` text.

The head has the datasets ``x``, ``y`` and those of the data, of shape ``(n_xi, n_eta)`` at nodes, one less in cells. No
node is in two files. In XDMF the last index runs fastest, so VTK's index i runs along eta, and j along xi: its
quadrilaterals are clockwise.
"""

from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from equimesh.io.by_parts.contents import PartData, blocks, cell_arrays, cell_type, node_block
from equimesh.io.by_parts.formats import PARTED_FORMATS
from equimesh.io.by_parts.layout import PartedGrid, part_reference
from equimesh.io.by_parts.virtual import Source, add_virtual, create
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import SIDES
from equimesh.meshes.mesh_part import MeshPart
from equimesh.numerics.types import IntArray

# XDMF's names of the types of numbers.
TYPES = {"f": "Float", "i": "Int"}


def write_part(path: Path, part: MeshPart, data: PartData) -> None:
    """Write the own nodes of ``part`` and its cells."""
    own, columns = part.last - part.first, part.grid.n_eta
    with create(path) as file:
        for name, values in {"x": part.x, "y": part.y, **data.nodes}.items():
            dataset = file.create_dataset(name, (own, columns), np.float64)
            for rows in blocks(own, columns):
                dataset[rows] = node_block(values, part, rows)
        for name, values in cell_arrays(data, part).items():
            dataset = file.create_dataset(name, values.shape, cell_type(name))
            for rows in blocks(*values.shape):
                dataset[rows] = values[rows]


def write_companion(path: Path, head: Path, parted: PartedGrid, nodes: Sequence[str], cells: Sequence[str]) -> None:
    """Write the virtual datasets of the head ``head`` to ``path``, and the edges of the four sides."""
    kind, (n_xi, n_eta) = PARTED_FORMATS["xdmf"], parted.grid.shape
    files = [part_reference(head, number, kind) for number in range(parted.count)]
    own = [Source(file=file, first=first, last=last) for file, (first, last) in zip(files, parted.ends, strict=True)]
    inner = []
    for number, file in enumerate(files):
        first, last = parted.cell_rows(number)
        inner.append(Source(file=file, first=first, last=last))
    with create(path) as file:
        for name in ("x", "y", *nodes):
            add_virtual(file, name, (n_xi, n_eta), np.float64, own)
        for name in (*cells, "subdomain"):
            add_virtual(file, name, (n_xi - 1, n_eta - 1), cell_type(name), inner)
        for side, edges in side_edges(parted.grid).items():
            file[f"sides/{side}"] = edges
        file.attrs["nodes"], file.attrs["cells"] = list(nodes), [*cells, "subdomain"]
        file.attrs["cuts"] = np.array(parted.cuts, dtype=np.int64)


def head_of(path: Path, parted: PartedGrid, nodes: Sequence[str], cells: Sequence[str]) -> str:
    """The text of the ``.xdmf`` head with this path, which refers to the ``.h5`` file next to it."""
    grid = parted.grid
    h5 = path.with_suffix(PARTED_FORMATS["xdmf"].companion).name
    at_nodes, in_cells = f"{grid.n_xi} {grid.n_eta}", f"{grid.n_xi - 1} {grid.n_eta - 1}"
    lines = [
        '<?xml version="1.0"?>',
        '<Xdmf Version="3.0"><Domain><Grid Name="Grid"><Time Value="0"/>',
        f'<Topology TopologyType="2DSMesh" Dimensions="{at_nodes}"/>',
        f'<Geometry GeometryType="X_Y">{_item(h5, "x", at_nodes)}{_item(h5, "y", at_nodes)}</Geometry>',
    ]
    for center, names, size in (("Node", nodes, at_nodes), ("Cell", (*cells, "subdomain"), in_cells)):
        lines += [
            f'<Attribute Name={quoteattr(name)} AttributeType="Scalar" Center="{center}">{_item(h5, name, size)}'
            "</Attribute>"
            for name in names
        ]
    return "\n".join([*lines, "</Grid></Domain></Xdmf>", ""])


def side_edges(grid: Grid) -> dict[str, IntArray]:
    """The edges of the four sides by the numbers of the nodes, shape ``(k, 2)``, the domain on their left."""
    n_xi, n_eta = grid.shape
    along_xi, along_eta = np.arange(n_xi, dtype=np.int64) * n_eta, np.arange(n_eta, dtype=np.int64)
    lines = {
        "left": along_eta[::-1],
        "right": along_xi[-1] + along_eta,
        "bottom": along_xi,
        "top": along_xi[::-1] + n_eta - 1,
    }
    return {side: np.column_stack([lines[side][:-1], lines[side][1:]]) for side in SIDES}


def _item(h5: str, name: str, size: str) -> str:
    dtype = np.dtype(cell_type(name))
    return (
        f'<DataItem Dimensions="{size}" NumberType="{TYPES[dtype.kind]}" Precision="{dtype.itemsize}" Format="HDF">'
        f"{_escaped(h5)}:/{name}</DataItem>"
    )


def _escaped(text: str) -> str:
    return quoteattr(text)[1:-1]
