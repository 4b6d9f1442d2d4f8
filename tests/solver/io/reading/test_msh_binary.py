"""Binary Gmsh files: both versions, both orders of bytes, blocks of one element, and sections that end too early."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from equimesh.io.reading.read import read_bytes
from solver.io.reading.plain import refusal, same, small


def head(version: str, order: str) -> bytes:
    return f"$MeshFormat\n{version} 1 8\n".encode() + struct.pack(f"{order}i", 1) + b"\n$EndMeshFormat\n"


def sections(**found: bytes) -> bytes:
    return b"".join(f"${name}\n".encode() + body + f"\n$End{name}\n".encode() for name, body in found.items())


def names() -> bytes:
    sides = list(small().sides)
    return "\n".join([str(len(sides)), *(f'1 {k} "{name}"' for k, name in enumerate(sides, start=1))]).encode()


def version_2(order: str, *, single: bool) -> bytes:
    """The small mesh; with ``single`` each element has a block of its own, as some programs write them."""
    mesh = small()
    nodes = np.zeros(len(mesh.points), np.dtype([("tag", f"{order}i4"), ("at", f"{order}f8", (3,))]))
    nodes["tag"], nodes["at"][:, :2] = np.arange(1, len(nodes) + 1), mesh.points
    tables = [(1, k, edges) for k, edges in enumerate(mesh.sides.values(), start=1)] + [(3, 9, mesh.cells)]
    count = sum(len(table) for _, _, table in tables)
    elements, number = f"{count}\n".encode(), 0
    for kind, group, table in tables:
        for rows in table[:, None] if single else [table]:
            elements += np.array([kind, len(rows), 2], f"{order}i4").tobytes()
            for row in rows:
                number += 1
                elements += np.array([number, group, group, *(row + 1)], f"{order}i4").tobytes()
    counted = f"{len(nodes)}\n".encode() + nodes.tobytes()
    return head("2.2", order) + sections(PhysicalNames=names(), Nodes=counted, Elements=elements)


def version_4(order: str) -> bytes:
    mesh = small()

    def longs(*numbers: int) -> bytes:
        return np.array(numbers, f"{order}u8").tobytes()

    def ints(*numbers: int) -> bytes:
        return np.array(numbers, f"{order}i4").tobytes()

    entities = longs(0, len(mesh.sides), 1, 0)
    for k in range(1, len(mesh.sides) + 1):
        entities += ints(k) + np.zeros(6, f"{order}f8").tobytes() + longs(1) + ints(k) + longs(2) + ints(1, -2)
    places = np.pad(mesh.points, ((0, 0), (0, 1))).astype(f"{order}f8").tobytes()
    count = len(mesh.points)
    nodes = longs(1, count, 1, count) + ints(2, 1, 0) + longs(count, *range(1, count + 1)) + places
    blocks = [(1, k, 1, edges) for k, edges in enumerate(mesh.sides.values(), start=1)] + [(2, 1, 3, mesh.cells)]
    total = sum(len(table) for *_, table in blocks)
    elements = longs(len(blocks), total, 1, total)
    for dimension, entity, kind, table in blocks:
        elements += ints(dimension, entity, kind) + longs(len(table))
        elements += b"".join(longs(number, *(row + 1)) for number, row in enumerate(table, start=1))
    return head("4.1", order) + sections(PhysicalNames=names(), Entities=entities, Nodes=nodes, Elements=elements)


FILES = {
    "2.2": version_2("<", single=False),
    "2.2, large end first": version_2(">", single=False),
    "2.2, a block for each element": version_2("<", single=True),
    "4.1": version_4("<"),
    "4.1, large end first": version_4(">"),
}


@pytest.mark.parametrize("name", FILES)
def test_the_mesh_comes_back(name: str) -> None:
    assert same(read_bytes(FILES[name], "msh"), small())


@pytest.mark.parametrize("name", ["2.2", "4.1"])
def test_a_section_that_ends_too_early_is_told(name: str) -> None:
    data = FILES[name]
    at = data.index(b"\n$EndElements")
    assert "ends too early" in refusal(data[: at - 40] + data[at:], "msh")


def test_the_order_of_bytes_has_to_be_told() -> None:
    assert "order of its bytes" in refusal(FILES["2.2"].replace(b"2.2 1 8\n\x01\0\0\0", b"2.2 1 8\n\x07\0\0\0"), "msh")
