"""Accept and Prefer, read as their RFCs say."""

from __future__ import annotations

import time

import pytest

from equimesh_service.wire.negotiation import choose_explicit_offer, choose_offer, parse_accept, parse_wait

OFFERS = {"vtu": "application/vnd.vtk.vtu+xml", "msh": "model/mesh"}


@pytest.mark.parametrize(
    ("header", "name"),
    [
        (None, "vtu"),
        ("*/*", "vtu"),
        ("model/*", "msh"),
        ("MODEL/MESH", "msh"),
        ("model/mesh;q=0.2, application/vnd.vtk.vtu+xml;q=0.1", "msh"),
        ("text/html, */*;q=0.1", "vtu"),
        ("model/mesh;q=0", None),
        ("text/html", None),
        ("", "vtu"),
        ("model/mesh;version=2;q=0.5", "msh"),
        ("a.c+", None),
        ("*/mesh", None),
        ("model/m*", None),
    ],
)
def test_the_most_wanted_offer_is_chosen(header: str | None, name: str | None) -> None:
    assert choose_offer(header, OFFERS) == name


@pytest.mark.parametrize(
    ("header", "name"),
    [
        (None, None),
        ("*/*", None),
        ("model/mesh", "msh"),
        ("application/json, model/mesh", None),
        ("application/json;q=0.5, model/mesh", "msh"),
        ("text/html, model/mesh;q=0.1", "msh"),
    ],
)
def test_a_mesh_is_sent_instead_of_json_only_when_it_is_named(header: str | None, name: str | None) -> None:
    assert choose_explicit_offer(header, OFFERS) == name


def test_a_long_header_is_read_at_once() -> None:
    began = time.perf_counter()
    assert choose_offer(",".join(f"*/********{number:x}" for number in range(2500)), OFFERS) is None
    assert time.perf_counter() - began < 1.0  # a search with patterns takes seconds


def test_equal_wishes_keep_their_order() -> None:
    assert parse_accept("b/b, a/a;q=1.0, c/c;q=0.9, d/d;q=0") == ["b/b", "a/a", "c/c"]


@pytest.mark.parametrize(
    ("header", "seconds"),
    [("wait=5", 5), ("respond-async, wait=10", 10), ('Wait="7"', 7), ("wait = 3", 3), ("wait=x", None), (None, None)],
)
def test_the_wait_that_is_preferred(header: str | None, seconds: int | None) -> None:
    assert parse_wait(header) == seconds
