"""Headers of requests and answers: limits, media types and waits, security, hosts and origins."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv6Address, ip_address
from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from equimesh_service.problems.problem import Problem

# The most bytes of a request line and its headers.
MAX_HEAD_BYTES = 32 * 1024
# Bytes of a header line in addition to name and value: colon, space, line end.
_LINE_BYTES = 4


class HeaderLimit:
    """ASGI middleware that answers 431 to a request whose head is too long."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or _head_bytes(scope) <= MAX_HEAD_BYTES:
            await self._app(scope, receive, send)
            return
        detail = f"The request line and the headers may have at most {MAX_HEAD_BYTES} bytes together."
        problem = Problem("headers-too-large", detail, headers={"Connection": "close"})
        await problem.response()(scope, receive, send)


def _head_bytes(scope: Scope) -> int:
    line = len(scope["method"]) + len(scope.get("raw_path") or scope["path"]) + len(scope["query_string"])
    return line + sum(len(name) + len(value) + _LINE_BYTES for name, value in scope["headers"])


# The most characters of a Prefer header.
MAX_PREFER = 200
_TOKEN = r"[!#$%&'*+.^_`|~0-9A-Za-z-]+"
_WORD = rf'({_TOKEN}|"[^"\\]*")'
_OTHER = rf"(?![Ww][Aa][Ii][Tt] *(=|;|,|$)){_TOKEN}( *= *{_WORD})?( *; *{_TOKEN}( *= *{_WORD})?)*"
_PREFERENCE = rf'([Ww][Aa][Ii][Tt] *= *("[0-9]{{1,9}}"|[0-9]{{1,9}})|{_OTHER})'
# The form of a Prefer header: preferences with commas between them; a wait has a whole number.
PREFER_PATTERN = rf"^{_PREFERENCE}( *, *{_PREFERENCE})*$"
_PREFER = re.compile(PREFER_PATTERN)
_EACH = re.compile(_PREFERENCE)
_WAIT = re.compile(r'wait *= *"?([0-9]+)"?', re.IGNORECASE)
_JSON = ("application/json", "application/problem+json")


def parse_accept(header: str) -> list[str]:
    """The media types of an Accept header, by falling quality; those with q=0 are left out."""
    found: list[tuple[float, str]] = []
    for entry in header.split(","):
        name, *parameters = (part.strip().lower() for part in entry.split(";"))
        quality = 1.0
        for parameter in parameters:
            if match := re.fullmatch(r"q\s*=\s*([01](?:\.\d{0,3})?)", parameter):
                quality = float(match.group(1))
        if name and quality > 0:
            found.append((-quality, name))
    return [name for _, name in sorted(found, key=lambda entry: entry[0])]


def choose_offer(header: str | None, offers: Mapping[str, str]) -> str | None:
    """The first choice of Accept among the offers, None for no match; without the header, the first offer.

    ``offers`` maps names to media types.
    """
    for wanted in parse_accept(header or "*/*"):
        group = wanted.removesuffix("*") if wanted.endswith("/*") else None
        for name, media_type in offers.items():
            if wanted in (media_type, "*/*", "*") or (group is not None and media_type.startswith(group)):
                return name
    return None


def choose_explicit_offer(header: str | None, offers: Mapping[str, str]) -> str | None:
    """The offer that Accept names before JSON and wildcards, None for no such offer."""
    for wanted in parse_accept(header or ""):
        if wanted in _JSON or "*" in wanted:
            return None
        for name, media_type in offers.items():
            if wanted == media_type:
                return name
    return None


def parse_wait(header: str | None) -> int | None:
    """The seconds of ``Prefer: wait=N``, None without them; raises a 400 problem for what is no Prefer header.

    Other preferences are allowed, and ignored, as RFC 7240 says.
    """
    if header is None:
        return None
    if len(header) > MAX_PREFER or not _PREFER.fullmatch(header):
        detail = f"Prefer: {header[:40]!r} cannot be read. Write wait=30, with a whole number of seconds."
        raise Problem("malformed-header", detail, remedy="Send Prefer: wait=30, or no Prefer.")
    found = (_WAIT.fullmatch(each[0]) for each in _EACH.finditer(header))
    return next((int(wait[1]) for wait in found if wait is not None), None)


_EXTRA = "equimesh.headers"

# Answers for programs: browsers may not run, load or frame anything in them.
_NOTHING = "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
# Pictures by matplotlib, with styles on every line, and images inside where there are many cells.
_PICTURE = f"{_NOTHING}; style-src 'unsafe-inline'; img-src data:; sandbox"
_ALWAYS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}
_POLICY = "Content-Security-Policy"


class SecurityHeaders:
    """An ASGI application with the headers on all its answers; bodies are not touched."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        extra: dict[str, str] = {}
        scope[_EXTRA] = extra

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                _complete(MutableHeaders(scope=message), extra)
            await send(message)

        await self._app(scope, receive, send_with_headers)


def add_headers(request: Request, headers: Mapping[str, str]) -> None:
    """Add headers to the answer of a request, whatever it will be."""
    request.scope.setdefault(_EXTRA, {}).update(headers)


def page_policy(*, pictures: str) -> str:
    """The policy of a page for people: its scripts, styles and requests are those of this service."""
    return f"{_NOTHING}; script-src 'self'; style-src 'self'; img-src {pictures}; font-src 'self'; connect-src 'self'"


def _complete(headers: MutableHeaders, extra: Mapping[str, str]) -> None:
    for name, value in _ALWAYS.items():
        headers.setdefault(name, value)
    if _POLICY not in headers:
        headers[_POLICY] = _PICTURE if headers.get("content-type", "").startswith("image/svg") else _NOTHING
    headers.setdefault("Cache-Control", "no-store")
    for name, value in extra.items():
        headers.setdefault(name, value)


# A name or an address of version 4, or an address of version 6 in brackets; then perhaps a port.
_HOST = re.compile(r"(?:\[([0-9a-f:.%a-z]+)\]|([^\s\[\]:/@?#\\]+))(?::(\d{1,5}))?", re.ASCII)
_DEFAULT_PORTS = {"http": 80, "https": 443}
# Every host is known.
ANY = "*"
# What `Sec-Fetch-Site` is for a request of this service's own pages, and of a person who typed the address.
_OWN_SITES = {"same-origin", "none"}


@dataclass(frozen=True, kw_only=True)
class Sender:
    """What the headers of a request say of its host, and of the page that sent it; None for a header that is absent.

    ``local`` is the address on which the connection arrived.
    """

    method: str
    local: str | None = None
    host: str | None = None
    origin: str | None = None
    site: str | None = None
    mode: str | None = None
    destination: str | None = None

    @property
    def is_foreign(self) -> bool:
        """Whether a page of another site sent the request. Programs other than browsers send none of these headers.

        A link from another site to a page of the service is not foreign.
        """
        if self.origin is not None and not _are_same(self.origin, self.host):
            return True
        if self.site is None or self.site.lower() in _OWN_SITES:
            return False
        is_link = self.method in {"GET", "HEAD"} and (self.mode, self.destination) == ("navigate", "document")
        return not is_link


class KnownHosts:
    """The hosts for which a service without API keys answers: loopback names, its own address, and ``allowed``."""

    def __init__(self, allowed: Iterable[str]) -> None:
        self._names = {_plain(host) for host in allowed}

    def has(self, sender: Sender) -> bool:
        """Whether the request's ``Host`` is known. A request without one is, since every browser sends one."""
        if sender.host is None or ANY in self._names:
            return True
        found = split_host(sender.host)
        if found is None:
            return False
        name = _plain(found[0])
        if name == "localhost" or name in self._names:
            return True
        address = _address(name)
        return address is not None and (address.is_loopback or address == _address(sender.local or ""))


def split_host(host: str) -> tuple[str, int | None] | None:
    """The name, without brackets and in small letters, and the port of a ``Host`` header; None for anything else."""
    found = _HOST.fullmatch(host.strip().lower())
    return None if found is None else (found[1] or found[2], None if found[3] is None else int(found[3]))


def _are_same(origin: str, host: str | None) -> bool:
    """Whether an origin, such as ``http://localhost:8000``, is that of the service at this host.

    The scheme only gives the default of the ports: behind a proxy with TLS the service does not always know it.
    """
    try:
        parts = urlsplit(origin.lower())
        name, port = parts.hostname, parts.port
    except ValueError:
        return False
    default = _DEFAULT_PORTS.get(parts.scheme)
    own = None if host is None else split_host(host)
    if default is None or name is None or own is None:
        return False
    return (_plain(name), port or default) == (_plain(own[0]), own[1] or default)


def _plain(name: str) -> str:
    """A name or an address as it is compared."""
    name = name.strip().strip("[]").lower().rstrip(".")
    address = _address(name)
    return name if address is None else str(address)


def _address(name: str) -> IPv4Address | IPv6Address | None:
    try:
        address = ip_address(name.strip("[]").partition("%")[0])
    except ValueError:
        return None
    # A socket for both versions names a client of version 4 so.
    return getattr(address, "ipv4_mapped", None) or address
