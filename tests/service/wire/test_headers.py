"""The head of a request has at most 32 KiB, in whatever pieces it comes."""

from __future__ import annotations

import socket
import time
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest

from equimesh_service.problems.problem import Problem
from equimesh_service.wire.headers import (
    MAX_HEAD_BYTES,
    KnownHosts,
    Sender,
    choose_explicit_offer,
    choose_offer,
    parse_accept,
    parse_wait,
    split_host,
)


@pytest.mark.parametrize("value", [{"X-Long": "a" * MAX_HEAD_BYTES}, {f"X-{k}": "a" * 100 for k in range(600)}])
def test_long_headers_are_refused(http: httpx.Client, value: dict[str, str]) -> None:
    answer = http.get("/livez", headers=value)
    assert (answer.status_code, answer.json()["type"]) == (431, "/problems/headers-too-large")
    assert http.get("/livez").status_code == 200


def test_a_long_query_is_refused(http: httpx.Client) -> None:
    assert http.get("/v1/meshes", params={"label": "a" * MAX_HEAD_BYTES}).status_code == 431


def test_headers_below_the_limit_are_read(http: httpx.Client) -> None:
    assert http.get("/livez", headers={"X-Long": "a" * (MAX_HEAD_BYTES - 1000)}).status_code == 200


def test_a_head_in_pieces_is_refused(url: str) -> None:
    place = urlsplit(url)
    answer = b""
    with socket.create_connection((place.hostname, place.port), timeout=20) as line, suppress(ConnectionError):
        line.sendall(b"GET /livez HTTP/1.1\r\nHost: a\r\nX-Long: ")
        for _ in range(6):
            time.sleep(0.02)
            line.sendall(b"a" * 10_000)
        line.sendall(b"\r\n\r\n")
        answer = line.recv(100)
    assert not answer or answer.split()[1] in (b"400", b"431")  # or it hangs up before all was sent


# Accept and Prefer, read as their RFCs say.


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


# Hosts and origins, as the headers of requests give them.


@pytest.mark.parametrize(
    ("host", "parts"),
    [
        ("127.0.0.1:8000", ("127.0.0.1", 8000)), ("LocalHost", ("localhost", None)), ("[::1]:80", ("::1", 80)),
        ("[::1]", ("::1", None)), ("a.example.", ("a.example.", None)), ("", None), ("a b", None), ("a:b", None),
        ("a:1:2", None), ("::1", None), ("user@a", None), ("a/b", None), ("[a", None), ("a:999999", None),
    ],
)  # fmt: skip
def test_a_host_has_a_name_and_perhaps_a_port(host: str, parts: tuple[str, int | None] | None) -> None:
    assert split_host(host) == parts


KNOWN = [
    "localhost", "LOCALHOST:8000", "localhost.", "127.0.0.1", "127.0.0.1:1", "127.3.2.1", "[::1]:8000", "[0:0::1]",
    "192.168.0.7:8000", "[::ffff:192.168.0.7]", "equimesh:8000", "Meshes.Example.org.", "[2001:db8::5]:8000",
]  # fmt: skip
UNKNOWN = [
    "evil.example", "localhost.evil.example", "127.0.0.1.evil.example", "evil.localhost.example", "192.168.0.8",
    "meshes.example.org.evil.example", "sub.meshes.example.org", "[::2]", "0.0.0.0", "2130706433", "127.1", "", "a b",
    "localhost,evil.example", "localhost@evil.example", "evil.example#localhost", "xn--lcalhost-74a",
]  # fmt: skip


@pytest.mark.parametrize(("host", "known"), [*((host, True) for host in KNOWN), *((host, False) for host in UNKNOWN)])
def test_names_of_this_machine_and_of_the_settings_are_known(host: str, known: bool) -> None:
    hosts = KnownHosts(["equimesh", "meshes.example.org", "2001:db8::5"])
    assert hosts.has(Sender(method="GET", host=host, local="192.168.0.7")) is known


def test_the_address_of_the_connection_is_known_also_of_a_socket_for_both_versions() -> None:
    sender = Sender(method="GET", host="192.168.0.7:8000", local="::ffff:192.168.0.7")
    assert KnownHosts([]).has(sender)
    assert not KnownHosts([]).has(Sender(method="GET", host="evil.example", local="evil.example"))


def test_a_star_knows_every_host_and_no_host_is_no_browser() -> None:
    assert KnownHosts(["*"]).has(Sender(method="GET", host="evil.example"))
    assert KnownHosts([]).has(Sender(method="GET", host=None))


@pytest.mark.parametrize(
    ("origin", "host", "foreign"),
    [
        ("http://127.0.0.1:8000", "127.0.0.1:8000", False),
        ("http://localhost", "localhost:80", False),
        ("https://meshes.example.org", "meshes.example.org", False),  # a proxy with TLS
        ("https://meshes.example.org:443", "Meshes.example.org", False),
        ("http://[::1]:8000", "[0::1]:8000", False),
        ("http://localhost:3000", "localhost:8000", True),
        ("http://localhost:8000", "127.0.0.1:8000", True),
        ("http://evil.example", "127.0.0.1:8000", True),
        ("http://127.0.0.1:8000.evil.example", "127.0.0.1:8000", True),
        ("http://evil.example:8000", None, True),
        ("http://a:x", "a", True),
        ("http://[", "a", True),
        ("chrome-extension://abc", "abc", True),
        ("null", "127.0.0.1:8000", True),
        ("", "127.0.0.1:8000", True),
    ],
)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_an_origin_is_that_of_the_host_or_foreign(method: str, origin: str, host: str | None, foreign: bool) -> None:
    assert Sender(method=method, host=host, origin=origin).is_foreign is foreign
    assert Sender(method=method, host=host, origin=origin, site="cross-site").is_foreign


LINK = {"mode": "navigate", "destination": "document"}


@pytest.mark.parametrize(
    ("method", "said", "foreign"),
    [
        ("POST", {}, False),
        ("POST", {"site": "same-origin"}, False),
        ("POST", {"site": "none"}, False),
        ("POST", {"site": "same-site"}, True),
        ("DELETE", {"site": "cross-site"}, True),
        ("POST", {"site": "Cross-Site", **LINK}, True),
        ("POST", {"site": "a new word"}, True),
        ("GET", {"site": "cross-site", **LINK}, False),
        ("HEAD", {"site": "same-site", **LINK}, False),
        ("GET", {"site": "cross-site", "mode": "navigate", "destination": "iframe"}, True),
        ("GET", {"site": "cross-site", "mode": "no-cors", "destination": "image"}, True),
        ("GET", {"site": "cross-site"}, True),
    ],
)
def test_requests_of_other_sites_are_foreign_and_links_are_not(
    method: str, said: dict[str, Any], foreign: bool
) -> None:
    assert Sender(method=method, host="127.0.0.1:8000", **said).is_foreign is foreign
