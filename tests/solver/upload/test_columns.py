"""Which column is u: by its name, by the choice of the sender, or a refusal that lists them."""

from __future__ import annotations

import pytest

from equimesh.errors import SamplesError
from equimesh.upload.columns import choose, header_columns, numbered_columns


@pytest.mark.parametrize(
    ("names", "column", "found"),
    [
        ("x y u", None, (0, 1, 2)),
        ("u id Y X", None, (3, 2, 0)),
        ("x y z", None, (0, 1, 2)),
        ("x y T", None, (0, 1, 2)),
        ("x y T p", "p", (0, 1, 3)),
        ("x y T t", "t", (0, 1, 3)),
        ("x y T p", "P", (0, 1, 3)),
        ("Points:0 Points:1 Points:2 temperature", None, (0, 1, 3)),
        ("Points:0 Points:1 Points:2 T p", "Points:2", (0, 1, 2)),
        ("CoordX CoordY T", None, (0, 1, 2)),
        ("a b c", None, None),
        ("x T", None, None),
    ],
)
def test_the_columns_of_a_header(names: str, column: str | None, found: tuple[int, int, int] | None) -> None:
    assert header_columns(names.split(), column) == found


@pytest.mark.parametrize(
    ("names", "column", "columns"),
    [
        ("x y T p", None, ("T", "p")),
        ("x y z T", None, ("z", "T")),
        ("Points:0 Points:1 Points:2 T p", None, ("T", "p")),
        ("x y T p", "x", ("T", "p")),
        ("x y T T", "T", ("T", "T")),
        ("x y u", "T", ("u",)),
    ],
)
def test_a_refusal_lists_the_columns(names: str, column: str | None, columns: tuple[str, ...]) -> None:
    with pytest.raises(SamplesError, match="column=NAME") as caught:
        header_columns(names.split(), column)
    assert caught.value.columns == columns
    assert all(name in caught.value.message for name in columns)


def test_a_file_with_places_alone_needs_values() -> None:
    with pytest.raises(SamplesError, match="add one with the values of u") as caught:
        header_columns(["x", "y"], None)
    assert caught.value.columns == ()


def test_columns_without_a_header_have_numbers() -> None:
    assert numbered_columns(3, None) == numbered_columns(5, "3") == (0, 1, 2)
    assert numbered_columns(5, "5") == (0, 1, 4)
    for width, column in ((5, "6"), (5, "2"), (5, "T"), (2, "3"), (4, "9" * 5000), (4, "²")):
        with pytest.raises(SamplesError, match="no number of a column"):
            numbered_columns(width, column)


def test_lists_and_names_are_short() -> None:
    with pytest.raises(SamplesError) as caught:
        numbered_columns(1000, None)
    assert caught.value.columns[-1] == "matrix"
    assert len(caught.value.columns) <= 51
    with pytest.raises(SamplesError) as caught:
        choose([f"{k}{'n' * 10_000}\n\x00" for k in range(1000)], None, ("x", "y"), "array")
    assert len(caught.value.message) < 2000
    assert len(caught.value.columns) <= 51
    assert caught.value.message.isprintable()
