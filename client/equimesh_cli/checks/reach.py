"""Checks of what is reached over the network: a service, and the workers of a cluster."""

from __future__ import annotations

import errno
import socket
from typing import TYPE_CHECKING

from equimesh_cli.checks.installation import Finding, failed, ok, warning

if TYPE_CHECKING:
    from equimesh_client import Client
    from equimesh_service.engine.port import PackedCall
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
    from equimesh_cli.checks.installation import has_tables, open_inspection
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
    from importlib import metadata

    here, there = metadata.version("equimesh"), str(client.capabilities()["version"])
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


# The check of a cluster: its scheduler, and whether its workers can solve the meshes of this service.


def cluster(settings: Settings) -> Finding | None:
    """Whether the cluster of the engine dask can be used; None for a service that needs none."""
    if settings.engine != "dask":
        return None
    from equimesh_service.engine.examination import examine

    place = f"the cluster at {settings.scheduler}"
    check = _check_of(settings)
    try:
        found = examine(settings.scheduler, check)
    except (OSError, ValueError) as error:
        message = f"the scheduler at {settings.scheduler} cannot be reached ({type(error).__name__})"
        return failed(message, "start it by dask scheduler --host ADDRESS; check the address, and the settings of TLS")
    workers = found.workers
    if not workers:
        return failed(f"{place} has no workers", f"start one: equimesh worker --scheduler {settings.scheduler}")
    faults = [f"worker {worker.name}: {worker.fault}" for worker in workers if worker.fault]
    if faults:
        remedy = "install the release of the service on all workers, and let them reach its database and files"
        all_of_them = len(faults) == len(workers)
        return (failed if all_of_them else warning)(f"{place}: {'; '.join(faults)}", remedy)
    small = [worker for worker in workers if worker.slots * settings.memory_limit > worker.memory]
    slots = sum(worker.slots for worker in workers)
    message = f"{place}: {len(workers)} workers solve {slots} meshes at the same time, in the versions of this service"
    if small:
        first = small[0]
        message += (
            f"; worker {first.name} has {first.memory} MiB for {first.slots} meshes of {settings.memory_limit} MiB each"
        )
        return warning(message, "lower EQUIMESH_MEMORY_LIMIT, or give the worker fewer processes")
    if is_open(found.address):
        message += f"; anyone who reaches the scheduler at {found.address} can run programs on all of them"
        remedy = "use TLS, see docs/how-to/cluster.md; on one machine: dask scheduler --host 127.0.0.1"
        return warning(message, remedy)
    reached = "all reach the database and the files" if check is not None else "the first start checks what they reach"
    return ok(f"{message}; {reached}")


def is_open(address: str) -> bool:
    """Whether other machines can reach a scheduler at this address without a certificate."""
    from equimesh_service.upkeep.exposure import is_loopback

    protocol, _, place = address.rpartition("://")
    return protocol != "tls" and not is_loopback(place.rpartition(":")[0])


def _check_of(settings: Settings) -> PackedCall | None:
    """The check of what workers reach; None before the first start, when there is nothing to reach."""
    from equimesh_service.engine.port import PackedCall
    from equimesh_service.files.address import files_address
    from equimesh_service.worker.job import Storage
    from equimesh_service.worker.reach import Reach

    reach = Reach.of(Storage(settings.database, files_address(settings)), mark=False)
    return PackedCall.of(reach.describe_faults) if reach.is_marked else None
