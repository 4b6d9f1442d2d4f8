"""The HTML that notebooks show."""

from __future__ import annotations

import re

from equimesh_schema.notebook import MAX_WARNINGS, html_of


def test_words_are_escaped_and_warnings_are_few() -> None:
    page = html_of("a < b", [("u", "<script>")], [f"warning {k}" for k in range(MAX_WARNINGS + 2)], b"PNG", 'a "mesh"')
    assert "a &lt; b" in page
    assert "<script>" not in page
    assert "warning 2" in page
    assert "warning 3" not in page
    assert "2 more warnings are in the certificate." in page
    assert 'alt="a &quot;mesh&quot;"' in page


def test_no_colour_is_set_so_that_it_is_read_in_light_and_dark() -> None:
    page = html_of("title", [("a", "1"), ("a", "2")])
    assert not re.search(r"colou?r|background", page)
    assert "<img" not in page
    assert page.count("<tr>") == 2
