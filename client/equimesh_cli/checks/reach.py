"""Checks of access to a service: its port, who may use it, and a running service."""

from __future__ import annotations

import errno
import importlib.metadata
import socket
from typing import TYPE_CHECKING

from equimesh_cli.checks.findings import Finding, failed, ok, warning

if TYPE_CHECKING:
    from equimesh_client import Client
    from equimesh_service.settings import Settings

TIMEOUT_SECONDS = 10.0


def port(settings: Settings) -> Finding:
    """Whether the address is free, or in use by a service of equimesh."""
    place = f"{settings.host} port {settings.port}"
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((settings.host, settings.port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE and _is_ours(settings):
                return ok(f"a service of equimesh answers at {place}")
            remedy = "choose another with EQUIMESH_PORT; 0 takes a free one"
            if error.errno == errno.EADDRINUSE:
                return failed(f"{place} is in use by another program", remedy)
            return failed(f"{place} cannot be used: {error.strerror or error}", "check EQUIMESH_HOST; " + remedy)
    return ok(f"{place} is free" if settings.port else f"{settings.host} has free ports")


def exposure(settings: Settings) -> Finding:
    """Whether others can use the service without a key."""
    from equimesh_cli.checks.storage import has_tables, open_inspection
    from equimesh_service.upkeep.exposure import is_loopback

    if is_loopback(settings.host):
        return ok(f"only this machine can reach {settings.host}")
    guarded = False
    if has_tables(settings):
        with open_inspection(settings) as inspection:
            guarded = inspection.has_keys()
    if guarded:
        return ok(f"other machines can reach {settings.host}, and need an API key")
    remedy = "create a key: equimesh keys create --name admin --scope admin"
    if settings.allow_anonymous:
        return warning(f"anyone who can reach {settings.host} can use this service: no API key exists", remedy)
    return failed(f"other machines can reach {settings.host}, and no key exists: the service will not start", remedy)


def readiness(client: Client) -> Finding:
    """Whether a running service reports that it is ready."""
    import httpx

    try:
        answer = httpx.get(f"{client.url}/readyz", timeout=TIMEOUT_SECONDS)
        checks = answer.json()["checks"]
    except httpx.HTTPError as error:
        return failed(f"{client.url} does not answer ({type(error).__name__})", "start the service, or correct --url")
    except (ValueError, KeyError, TypeError):
        return failed(f"{client.url} is no service of equimesh", "correct --url, or the proxy in front of the service")
    wrong = [f"{name}: {message}" for name, message in checks.items() if message != "ok"]
    if wrong or answer.status_code != 200:
        return failed("; ".join(wrong) or f"status {answer.status_code}", "see the log of the service")
    return ok(f"{client.url} is ready: {', '.join(checks)}")


def version(client: Client) -> Finding:
    """Whether a running service has the release that is installed here."""
    here, there = importlib.metadata.version("equimesh"), str(client.capabilities()["version"])
    if here != there:
        return warning(f"the service has release {there}; this is {here}", "restart the service after an upgrade")
    return ok(f"release {there}, the same as here")


def key(client: Client) -> Finding:
    """Whether the service accepts the key, or needs none."""
    from equimesh_client.errors import Forbidden, Unauthorized

    try:
        next(iter(client.meshes.list()), None)
    except (Unauthorized, Forbidden) as error:
        message = str(error).splitlines()[0]
        return failed(f"the service refuses the key: {message}", "set EQUIMESH_KEY to a key of `equimesh keys create`")
    return ok("the service accepts the key" if _requires_key(client) else "no key is needed")


def round_trip(client: Client) -> Finding:
    """Whether a running service solves and returns a small mesh."""
    from equimesh_client.errors import EquimeshClientError, Forbidden, Unauthorized

    try:
        mesh = client.generate(
            "tanh(5*(x - y))", 9, label="equimesh doctor", reuse=False, deadline=60.0, progress=False
        )
        points = len(mesh.points)
        mesh.delete()
    except (Forbidden, Unauthorized) as error:
        return warning(f"no mesh was requested: {str(error).splitlines()[0]}", "use a key with the scope write")
    except EquimeshClientError as error:
        return failed(f"no mesh came back: {str(error).splitlines()[0]}", "see the log of the service")
    return ok(f"a mesh of {points} points came back and was deleted")


def _requires_key(client: Client) -> bool:
    import httpx

    return httpx.get(f"{client.url}/v1/meshes?limit=1", timeout=TIMEOUT_SECONDS).status_code == 401


def _is_ours(settings: Settings) -> bool:
    import httpx

    host = {"0.0.0.0": "127.0.0.1", "::": "::1", "": "127.0.0.1"}.get(settings.host, settings.host)
    shown = f"[{host}]" if ":" in host else host
    try:
        answer = httpx.get(f"http://{shown}:{settings.port}/readyz", timeout=TIMEOUT_SECONDS, trust_env=False)
        return "dispatcher" in answer.json()["checks"]
    except (httpx.HTTPError, ValueError, KeyError, TypeError):
        return False
