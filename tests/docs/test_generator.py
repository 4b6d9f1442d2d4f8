"""The generator of the site: where links lead, what the reference says of a schema and a name, and what it repairs."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from generator.checks import broken_links
from generator.faces import FACES, comment_of, groups, path_of_last, public_names, public_path
from generator.inline import move_inline
from generator.places import place_of, relinked
from generator.repairs import repaired
from generator.schemas import escaped, keys_table, type_of
from test_structure import FACES as ALLOWED


def test_links_to_pages_and_files_lead_to_their_places_on_the_site() -> None:
    found: list[str] = []
    text = (
        "[a](../reference/http.md#bodies) [b](../../examples/01_first_mesh.py) ![c](../images/adapt.png)\n"
        "[d](../../examples/README.md#x) [e](https://b.org/a.md) [f](#here) `[g](../x.md)` [h](../../CHANGELOG.md)\n"
        "```text\n[i](../none.md)\n```\n[j](../../examples/from_outside/fetch)\n"
    )
    expected = (
        "[a](../reference/http.md#bodies) [b](../examples/01_first_mesh.md) ![c](../images/adapt.png)\n"
        "[d](../examples/index.md#x) [e](https://b.org/a.md) [f](#here) `[g](../x.md)` [h](../project/changelog.md)\n"
        "```text\n[i](../none.md)\n```\n[j](../files/examples/from_outside/fetch.md)\n"
    )
    assert relinked(text, "docs/how-to/adapt.md", found.append) == expected
    assert "examples/01_first_mesh.py" in found
    assert place_of("docs/index.md") == "index.md"


def test_a_link_that_leads_nowhere_is_refused_with_its_page() -> None:
    with pytest.raises(ValueError, match=r"docs/index\.md: the link to how-to/none\.md leads nowhere"):
        relinked("[a](how-to/none.md)", "docs/index.md", print)


def test_every_public_name_is_documented_once_under_its_heading() -> None:
    assert set(FACES) == ALLOWED
    for face in FACES:
        listed = [name for _, names in groups(face) for name in names]
        assert listed == list(sys.modules[face].__all__)
    assert groups("equimesh")[1][1][:2] == ["Problem", "Grid"]
    assert public_names()["equimesh.schwarz.Schwarz"].path == "equimesh.Schwarz"


def test_a_name_is_found_by_the_module_that_defines_it() -> None:
    assert public_path("equimesh.meshes.mesh.Mesh") == "equimesh.Mesh"
    assert public_path("equimesh.quality.measures.Quality.q_eq") == "equimesh.Quality.q_eq"
    assert public_path("equimesh.numerics.types.Array") is None
    assert path_of_last("GridSamples") == "equimesh.GridSamples"
    assert path_of_last("Mesh") is None  # of two packages
    assert comment_of(public_names()["equimesh.plot.COLOURS"])


def test_a_schema_is_a_table_of_keys_in_plain_words() -> None:
    schema = {
        "properties": {
            "n": {"type": "integer", "minimum": 2, "default": 64, "description": "Points | lines, x[i]*y"},
            "u": {"anyOf": [{"$ref": "#/components/schemas/GridSource"}, {"type": "null"}]},
            "box": {"type": "array", "items": {"type": "number"}, "maxItems": 2},
            "kind": {"enum": ["l2", "h1"]},
        },
        "required": ["u"],
    }
    _, _, n, u, box, kind, _ = keys_table(schema)
    assert n == r"| `n` | integer (at least 2) | `64` | Points \| lines, x\[i\]\*y |"
    assert u == "| `u` | [GridSource](schemas.md#gridsource) or null | required |  |"
    assert "list of number (at most 2 items)" in box
    assert '`"l2"` or `"h1"`' in kind
    assert escaped("`a|b` < c") == r"`a\|b` \< c"
    assert type_of({"type": "object", "additionalProperties": {"type": "string"}}) == "object of text"


def test_scripts_and_styles_move_into_files(tmp_path: Path) -> None:
    (tmp_path / "_static").mkdir()
    (tmp_path / "a").mkdir()
    inline = '<head><style>p{}</style></head><script>let a;</script><script src="x.js"></script>'
    (tmp_path / "a/page.html").write_text(f'{inline}<p class="b" style="color: red">c</p><i style="color: red">d</i>')
    (tmp_path / "404.html").write_text('<head></head><a href="index.html">e</a><a href="#f">f</a>')
    move_inline(tmp_path)
    text = (tmp_path / "a/page.html").read_text()
    assert "style=" not in text
    assert "<style" not in text
    assert "let a" not in text
    assert text.count('<script src="') == 2
    assert '<p class="b declared-' in text
    assert '<i class="declared-' in text
    (script,) = (tmp_path / "_static").glob("moved-*.js")
    assert script.read_text() == "let a;\n"
    assert f'src="../_static/{script.name}"' in text
    assert "color: red" in (tmp_path / "_static/declarations.css").read_text()
    assert '<a href="{{root}}index.html">e</a><a href="#f">f</a>' in (tmp_path / "404.html").read_text()


def test_what_scrolls_is_reached_by_the_keyboard() -> None:
    assert repaired('<aside class="toc-drawer no-toc"><pre>a</pre>') == (
        '<aside aria-label="Page" class="toc-drawer no-toc"><pre tabindex="0">a</pre>'
    )
    assert "<dl>" not in repaired('<dl>\n<dd><em class="sig-param">a</em>,</dd>\n</dl>')


def test_a_broken_link_in_a_built_page_is_named(tmp_path: Path) -> None:
    site = tmp_path / "site"
    (site / "a").mkdir(parents=True)
    (site / "index.html").write_text(
        '<a href="a/page.html#here">x</a><a href="../#u=1">y</a><a href="https://b.org">z</a>'
    )
    (site / "a/page.html").write_text(
        '<p id="here"><a href="../#none">x</a><a href="../c.html">y</a><a href="../">z</a>'
    )
    assert broken_links(site) == [
        "a/page.html: the link to ../#none leads nowhere.",
        "a/page.html: the link to ../c.html leads nowhere.",
    ]
