"""`equimesh doctor`: checks an installation and prints remedies."""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from equimesh_cli.checks import installation, reach
from equimesh_cli.checks.installation import Finding, Level, failed
from equimesh_cli.options.service import add_settings, add_url, cause, explicit_settings, merged_settings
from equimesh_cli.parser import CommandError, Exit, NotInstalled, add_command

if TYPE_CHECKING:
    from equimesh_client import Client
    from equimesh_service.settings import Settings

EXAMPLES = """\
examples:
  equimesh doctor
  equimesh doctor --data-dir /var/lib/equimesh --stored
  equimesh doctor --url https://meshes.example.org

It takes the options of `equimesh serve` and checks a service with them on this machine. It creates no folder and
changes no data. With --url (or EQUIMESH_URL) it checks the service there instead, and nothing here.

needs the service, except with --url: pip install 'equimesh[service]'

"""
EXITS = {
    Exit.DONE: "no check failed; warnings do not count",
    Exit.FAILED: "a check failed",
    Exit.INPUT: "bad usage or a bad setting",
}
HERE: dict[str, Callable[[Settings], Finding | None]] = {
    "python": installation.python,
    "packages": installation.packages,
    "settings": installation.variables,
    "kernels": installation.kernels,
    "solve": installation.solve,
    "processors": installation.processors,
    "memory": installation.memory,
    "folder": installation.folder,
    "disk": installation.disk,
    "database": installation.database,
    "clock": installation.clock,
    "files": installation.files,
    "cluster": reach.cluster,
    "port": reach.port,
    "exposure": reach.exposure,
}
# For a running service.
THERE: dict[str, Callable[[Client], Finding]] = {
    "ready": reach.readiness,
    "version": reach.version,
    "key": reach.key,
    "round trip": reach.round_trip,
}


def add_parser(commands: Any, *, full: bool) -> None:
    """Add the command; with ``full`` the settings of the service, too."""
    parser = add_command(
        commands,
        "doctor",
        help="check an installation",
        description="Check what a service needs on this machine, or with --url a running service; print the remedies.",
        examples=EXAMPLES,
        exits=EXITS,
        usage="equimesh doctor [OPTIONS]",
    )
    add_url(parser, default=None)
    parser.add_argument("--stored", action="store_true", help="also see that every file the database names is there")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=run)
    if full:
        add_settings(parser)


def run(options: argparse.Namespace) -> int:
    """Run the checks, and print a line for each as soon as it is done."""
    found: list[tuple[str, Finding]] = []
    for name, finding in _there(options) if options.url else _here(options):
        found.append((name, finding))
        if not options.json:
            print(_text(name, finding), flush=True)
    levels = Counter(finding.level for _, finding in found)
    if options.json:
        checks = [{"check": name, "level": f.level, "said": f.message, "remedy": f.remedy} for name, f in found]
        print(json.dumps({"status": max(levels, key=list(Level).index), "checks": checks}, indent=2))
    else:
        print(f"\n{len(found)} checks: {levels[Level.FAILED]} failed, {levels[Level.WARNING]} with a warning")
    return Exit.FAILED if levels[Level.FAILED] else Exit.DONE


def _here(options: argparse.Namespace) -> Iterator[tuple[str, Finding]]:
    """The findings of this machine with the names of their checks; without checks that do not apply."""
    try:
        import equimesh_service.settings  # noqa: F401
    except ImportError as error:
        raise NotInstalled("service", error) from error
    settings = merged_settings(explicit_settings(options))
    checks = {**HERE, **({"stored": installation.stored_files} if options.stored else {})}
    for name, check in checks.items():
        finding = _try_check(check, settings)
        if finding is not None:
            yield name, finding


def _there(options: argparse.Namespace) -> Iterator[tuple[str, Finding]]:
    """The findings of a running service; without an answer to the first check there are no others."""
    from equimesh_client import Client, EquimeshClientError

    if options.stored or explicit_settings(options):
        raise CommandError(
            "--stored and the options of `equimesh serve` concern this machine; --url (or EQUIMESH_URL) names "
            "another service: leave out one of them; --url '' is none"
        )
    with Client(options.url, key=options.key, retries=1, timeout=reach.TIMEOUT_SECONDS) as client:
        for name, check in THERE.items():
            try:
                finding = check(client)
            except EquimeshClientError as error:
                finding = failed(str(error).splitlines()[0])
            yield name, finding
            if name == "ready" and finding.level is Level.FAILED:
                return


def _try_check(check: Callable[[Settings], Finding | None], settings: Settings) -> Finding | None:
    """The finding of a check. An error of the part that it examines is a finding, too."""
    from sqlalchemy.exc import SQLAlchemyError

    from equimesh_service.errors import CannotServeError

    try:
        return check(settings)
    except CannotServeError as error:
        return failed(str(error).splitlines()[0])
    except ImportError as error:
        return failed(f"{error.name} is not installed", "see the check of the packages")
    except SQLAlchemyError as error:
        remedy = "check EQUIMESH_DATABASE_URL, and that the database runs"
        return failed(f"the database does not answer ({cause(error)})", remedy)
    except OSError as error:
        return failed(f"{error.filename or ''} {error.strerror or error}".strip(), "check that it can be reached")


def _text(name: str, finding: Finding) -> str:
    remedy = f"\n{'':<22}-> {finding.remedy}" if finding.remedy else ""
    return f"{finding.level:<9}{name:<13}{finding.message}{remedy}"
