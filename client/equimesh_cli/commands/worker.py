"""`equimesh worker`: a worker of a cluster."""

import argparse
from typing import Any

from equimesh_cli.options.service import merged_settings
from equimesh_cli.parser import CommandError, Exit, NotInstalled, add_command

EXAMPLES = """\
Every option is also an environment variable, as of `equimesh serve`: --workers is EQUIMESH_WORKERS.

examples:
  equimesh worker --scheduler tls://a:8786 --host b
  equimesh worker --scheduler tls://a:8786 --host b --workers 4 --name rack-7
  EQUIMESH_SCHEDULER=tls://a:8786 equimesh worker --host b

It waits for the scheduler, and joins again when the scheduler was lost. The service says what it needs to reach.

needs the service and Dask: pip install 'equimesh[service,dask]'

"""
EXITS = {
    Exit.DONE: "stopped by a signal",
    Exit.INPUT: "the worker cannot start: a bad setting, or no scheduler is named",
}


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "worker",
        help="join a cluster as a worker",
        description="Solve meshes for a service with the engine dask, until it is stopped.",
        examples=EXAMPLES,
        exits=EXITS,
    )
    for name, help_ in (
        ("scheduler", "address of the scheduler of the cluster, e.g. tls://first:8786"),
        ("workers", "processes that solve (one for each processor)"),
        ("log-level", "least level logged (info)"),
        ("log-format", "text or json (text)"),
    ):
        parser.add_argument(f"--{name}", dest=f"setting_{name.replace('-', '_')}", help=help_)
    parser.add_argument("--name", help="name of this worker in messages (its machine and process)")
    parser.add_argument("--host", default="", help="address on which others reach this worker (all of its machine)")
    parser.add_argument(
        "--health-port", type=int, default=0, help="port on which GET /health answers while this runs (a free one)"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Be a worker in this process."""
    given = {
        name: value
        for name in ("scheduler", "workers", "log_level", "log_format")
        if (value := getattr(options, f"setting_{name}")) is not None
    }
    try:
        from equimesh_service.files.folder import withhold_files
        from equimesh_service.telemetry import logs
    except ImportError as error:
        raise NotInstalled("service", error) from error
    settings = merged_settings({"engine": "dask", **given})
    logs.configure(settings.log_level, settings.log_format)
    try:
        from equimesh_service.engine.cluster_worker import default_name, run_worker
    except ImportError as error:
        raise NotInstalled("dask", error) from error
    withhold_files()
    try:
        name = options.name or default_name()
        run_worker(settings.scheduler, settings.workers, name, options.health_port, options.host)
    except ValueError as error:  # an address that Dask cannot read
        raise CommandError(f"{settings.scheduler}: {error}") from None
    return Exit.DONE
