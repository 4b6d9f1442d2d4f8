"""Dictionaries of OpenFOAM: entries, lists, variables; and what is refused, by its line."""

from __future__ import annotations

import io
import re
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from equimesh.errors import InputError
from equimesh.io.reading.foam import Entries, Items, Word, list_of, numbers_of, one_word, parse, read_poly_mesh, text_of
from equimesh.io.reading.read import read_bytes, read_mesh
from equimesh.io.solver_files import foam_files
from solver.io.reading.plain import refusal, same, small

TEXT = """// a comment
scale 0.5; /* two
lines */
pair (1 2);
list ( a $pair (3 4) "a b" );
inner { x 1; deep { y 2; } }
empty ( );
"""


def test_entries_lists_and_variables() -> None:
    found = parse(TEXT)
    assert one_word(found.values["scale"], "scale").number() == 0.5
    items = list_of(found, "list")
    assert [text_of(item) for item in items] == ["a", "( )", "( )", '"a b"']
    assert numbers_of(items[1], 2) == [1, 2]
    (inner,) = found.values["inner"]
    assert isinstance(inner, Entries)
    (deep,) = inner.values["deep"]
    assert isinstance(deep, Entries)
    assert deep.values["y"] == [Word("2", 6)]
    assert list_of(found, "empty") == []
    assert list_of(found, "none", needed=False) == []


def test_a_file_that_is_one_list() -> None:
    loose = parse("FoamFile { version 2.0; }\n1\n(\n wall { nFaces 3; }\n)\n").loose
    assert isinstance(loose[-1], Items)
    assert text_of(loose[-1].items[0]) == "wall"


REFUSED = {
    "line 2: '#calc' needs OpenFOAM": 'a 1;\nb #calc "1 + 2";',
    "line 1: '#include' needs OpenFOAM": '#include "other"',
    "line 3: the variable '$c' is no entry above it": "a 1;\nb 2;\nd $c;",
    "the variable '$:a.b'": "a { b 1; }\nc $:a.b;",
    "line 2: the file ends inside an entry": "a { b 1;\n",
    "line 1: this '(' is not closed": "a ( 1 2",
    "line 1: ')' is not expected here": "a 1 );",
    "line 2: the entry 'b' does not end with ';'": "a 1;\nb 2",
    "more than 32 lists inside each other": "a " + "(" * 40 + ")" * 40 + ";",
    "variables bring more than": "a0 (1);" + "".join(f"a{k + 1} (" + f"$a{k} " * 10 + ");" for k in range(8)),
}


@pytest.mark.parametrize("told", REFUSED)
def test_what_is_no_literal_dictionary_is_refused_by_its_line(told: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(REFUSED[told])
    assert told in caught.value.message


def test_wrong_kinds_of_items_are_named() -> None:
    found = parse("a (1 2);\nb x;\nc (1 (2));")
    with pytest.raises(InputError, match="line 2: 'x' is no number"):
        one_word(found.values["b"], "b").number()
    with pytest.raises(InputError, match="line 1: a needs one value"):
        one_word(found.values["a"], "a")
    with pytest.raises(InputError, match="line 3: one word or number is expected"):
        numbers_of(found.values["c"][0], 2)
    with pytest.raises(InputError, match="line 1: 3 numbers"):
        numbers_of(found.values["a"][0], 3)
    with pytest.raises(InputError, match=r"line 2: the blockMeshDict needs a list b"):
        list_of(found, "b")


@pytest.mark.parametrize("bad", ["/* ", '"\\'])
def test_comments_and_texts_that_never_end_are_searched_once(bad: str) -> None:
    with pytest.raises(InputError):
        parse("a " + bad * 200_000)


def test_a_text_that_does_not_end_takes_little_memory() -> None:
    text = '("' + "\\" * (1 << 20)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="is not closed"):
            parse(text)
        assert tracemalloc.get_traced_memory()[1] < 20 * len(text)
    finally:
        tracemalloc.stop()


# OpenFOAM meshes: our own layer back again, layers across other axes, and what others are told.


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
