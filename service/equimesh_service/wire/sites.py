"""Hosts and origins of requests: which names mean this service, and which requests pages of other sites have sent.

A service without API keys needs both. Browsers send requests of any page to any address, and a page can have its own
name resolve to the loopback address (DNS rebinding).
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv6Address, ip_address
from urllib.parse import urlsplit

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
