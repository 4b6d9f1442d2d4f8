"""Accept and Prefer, read as their RFCs say."""

from __future__ import annotations

import time

import pytest

from equimesh_service.problems.problem import Problem
from equimesh_service.wire.headers import choose_explicit_offer, choose_offer, parse_accept, parse_wait

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
    began = time.process_time()
    assert choose_offer(",".join(f"*/********{number:x}" for number in range(2500)), OFFERS) is None
    assert time.process_time() - began < 1.0  # a search with patterns takes seconds


@pytest.mark.parametrize(
    ("header", "seconds"),
    [
        (None, None),
        ("wait=30", 30),
        ('Wait = "30"', 30),
        ("respond-async, wait=10", 10),
        ('return=minimal; foo="a, wait=3", wait=0', 0),
        ("respond-async", None),
        ("waiting=x, await=3", None),
    ],
)
def test_a_wait_is_found_among_preferences(header: str | None, seconds: int | None) -> None:
    assert parse_wait(header) == seconds


@pytest.mark.parametrize(
    "header",
    [
        "",
        "wait",
        "wait=",
        "wait=abc",
        "wait=-1",
        "wait=1.5",
        "wait=30s",
        "wait 30",
        "wait=1;wait=2",
        "wait=9999999999",
        ",,;=",
        "a=",
        'a="',
        "wait=1,",
        "a" * 201,
    ],
)
def test_a_preference_that_cannot_be_read_is_refused(header: str) -> None:
    with pytest.raises(Problem) as caught:
        parse_wait(header)
    assert caught.value.name == "malformed-header"


def test_equal_wishes_keep_their_order() -> None:
    assert parse_accept("b/b, a/a;q=1.0, c/c;q=0.9, d/d;q=0") == ["b/b", "a/a", "c/c"]
