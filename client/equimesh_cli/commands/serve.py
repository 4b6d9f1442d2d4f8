"""`equimesh serve`: run the service."""

import argparse
import gc
import signal
import sys
import threading
from typing import Any

from equimesh_cli.options.service import add_settings, explicit_settings, merged_settings, start_error
from equimesh_cli.parser import CommandError, Exit, NotInstalled, add_command

EXAMPLES = """\
Every option is also an environment variable: --data-dir is EQUIMESH_DATA_DIR. The option wins.

examples:
  equimesh serve
  equimesh serve --host 0.0.0.0 --port 9000 --data-dir meshes --workers 8
  EQUIMESH_PORT=9000 equimesh serve

needs the service: pip install 'equimesh[service]'

"""
EXITS = {
    Exit.DONE: "stopped, by a signal or with Ctrl-C",
    Exit.INPUT: "the service cannot start: a bad setting, a folder or port in use",
}


def add_parser(commands: Any, *, full: bool) -> None:
    """Add the command; with ``full`` its options, too, which are the settings that the service declares."""
    parser = add_command(
        commands,
        "serve",
        help="run a service",
        description="Run the service until it is stopped.",
        examples=EXAMPLES,
        exits=EXITS,
        usage="equimesh serve [OPTIONS]",
    )
    parser.set_defaults(run=run)
    if full:
        add_settings(parser)


def run(options: argparse.Namespace) -> int:
    """Run the service in this process."""
    if threading.current_thread() is threading.main_thread():
        # The imports take seconds, and the first process of a container gets no SIGTERM without a handler.
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(Exit.DONE))
    was_enabled = gc.isenabled()
    gc.disable()  # until the server runs: what is imported stays, and to look through it takes a fifth of the time
    try:
        return _serve(options)
    finally:
        if was_enabled:
            gc.enable()


def _serve(options: argparse.Namespace) -> int:
    try:
        import equimesh_service
        from equimesh_service.errors import CannotServeError
    except ImportError as error:
        raise NotInstalled("service", error) from error
    settings = merged_settings(explicit_settings(options))
    try:
        equimesh_service.run(settings)
    except KeyboardInterrupt:
        pass  # the way to stop it
    except CannotServeError as error:
        raise CommandError(str(error)) from None
    except OSError as error:
        raise CommandError(start_error(settings, error)) from error
    return Exit.DONE
