"""Hosts and origins, as the headers of requests give them."""

from __future__ import annotations

from typing import Any

import pytest

from equimesh_service.wire.headers import KnownHosts, Sender, split_host


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
