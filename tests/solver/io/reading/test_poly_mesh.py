"""OpenFOAM meshes: our own layer back again, layers across other axes, and what others are told."""

from __future__ import annotations

import io
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest

from equimesh.errors import InputError
from equimesh.io.reading.foam import read_poly_mesh
from equimesh.io.reading.read import read_bytes, read_mesh
from equimesh.io.solver_files import foam_files
from solver.io.reading.plain import refusal, same, small


def files() -> dict[str, str]:
    mesh = small()
    return foam_files(mesh.points, mesh.cells, mesh.sides)


def zipped(texts: dict[str, str]) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, text in texts.items():
            archive.writestr(f"constant/polyMesh/{name}", text)
    return packed.getvalue()


def test_our_own_layer_comes_back_to_the_bit(tmp_path: Path) -> None:
    assert same(read_bytes(zipped(files()), "zip"), small())
    folder = tmp_path / "constant" / "polyMesh"
    folder.mkdir(parents=True)
    for name, text in files().items():
        (folder / name).write_text(text)
    for place in (tmp_path, tmp_path / "constant", folder):
        assert same(read_mesh(place), small())


def test_a_layer_across_another_axis() -> None:
    turned = re.sub(r"^\((\S+) (\S+) (\S+)\)$", r"(\1 \3 \2)", files()["points"], flags=re.MULTILINE)
    assert same(read_bytes(zipped(files() | {"points": turned}), "zip"), small())


def test_comments_and_groups_of_other_writers() -> None:
    boundary = files()["boundary"].replace("type patch;", "type wall; inGroups 1(wall); // two words", 1)
    note = files()["faces"].replace("faceList;", "faceList; /* 4(9 9\n9 9) */")
    assert same(read_bytes(zipped(files() | {"boundary": boundary, "faces": note}), "zip"), small())


def test_a_patch_may_also_lie_in_the_planes() -> None:
    boundary = files()["boundary"].replace("left\n", "rest\n", 1)
    boundary = re.sub(r"(?s)\nfrontAndBack.*?\}", "", boundary)
    boundary = re.sub(r"(?s)(top\n\{.*?nFaces) 3;", r"\1 15;", boundary).replace("\n5\n", "\n4\n")
    found = read_bytes(zipped(files() | {"boundary": boundary}), "zip")
    assert list(found.sides) == ["rest", *list(small().sides)[1:]]
    np.testing.assert_array_equal(found.sides["top"], small().sides["top"])


BROKEN = {
    "no file 'owner'": {"owner": None},
    "the file 'faces' is binary: convert it with foamFormatConvert": {"faces": ("format ascii", "format binary")},
    "do not lie in two planes": {"points": ("(0.0 0.0 0.0)", "(0.0 0.0 0.1)")},
    "'x' is no integer, among the file 'owner'": {"owner": ("\n0\n", "\nx\n")},
    "the patch 'top' has no nFaces": {"boundary": (r"(top\n\{\n    type patch;\n)    nFaces 3;", r"\1")},
    "the patch 'top' has faces that there are not": {
        "boundary": (r"(top\n\{\n    type patch;\n    nFaces) 3", r"\1 30")
    },
    "is a triangle": {"faces": (r"4\(1 4 3 0\)", "3(1 4 3)")},
    "the list in 'owner' does not have the length": {"owner": (r"\n29\n", "\n28\n")},
}


@pytest.mark.parametrize("told", BROKEN)
def test_other_meshes_are_refused_with_what_is_wrong(told: str) -> None:
    texts = files()
    for name, change in BROKEN[told].items():
        if change is None:
            del texts[name]
        else:
            new = re.sub(*change, texts[name], count=1)
            assert new != texts[name]
            texts[name] = new
    assert told in refusal(zipped(texts), "zip")


def test_a_zip_that_is_none() -> None:
    assert "the zip file cannot be unpacked" in refusal(b"PK", "zip")


def test_a_layer_of_two_cells_is_refused() -> None:
    mesh = small()
    points = np.concatenate([np.pad(mesh.points, ((0, 0), (0, 1)), constant_values=z) for z in (0.0, 1.0, 2.0)])
    rows = "\n".join(f"({x} {y} {z})" for x, y, z in points.tolist())
    with pytest.raises(InputError, match="only one layer"):
        read_poly_mesh({name: text.encode() for name, text in (files() | {"points": f"36\n(\n{rows}\n)"}).items()})


def test_faces_and_patches_take_no_more_than_there_is() -> None:
    many = "2(1000(" + "0 " * 1000 + ")3(0 1 2))"
    assert "a face has 1000 points: 100 are possible" in refusal(zipped({**files(), "faces": many}), "zip")
    patches = "".join(f"p{k}{{startFace 0; nFaces 9;}}" for k in range(9))
    assert "the patches in 'boundary' overlap" in refusal(zipped({**files(), "boundary": f"9({patches})"}), "zip")


@pytest.mark.parametrize("bad", ["FoamFile{", "/* "])
def test_what_never_ends_is_searched_once(bad: str) -> None:
    assert "'points'" in refusal(zipped({**files(), "points": bad * 200_000}), "zip")
