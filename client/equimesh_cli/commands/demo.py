"""`equimesh demo`: starts a service, requests meshes and writes their files."""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from equimesh_cli.options.service import start_error
from equimesh_cli.parser import CommandError, Exit, NotInstalled, add_command

if TYPE_CHECKING:
    from equimesh_client import Client, Mesh

FORMATS = ("vtu", "vtk", "xdmf", "msh")
WAVE = "tanh(40*(y - 0.5 - 0.1*sin(2*pi*x)))"
PAPER = "(1-exp(15*(x-1)))*sin(pi*y)"
EXAMPLES = """\
examples:
  equimesh demo
  equimesh demo --output meshes

needs the service: pip install 'equimesh[service]'

"""
EXITS = {
    Exit.FAILED: "a mesh failed",
    Exit.INPUT: "bad usage, or the service is not installed",
    Exit.UNREACHABLE: "the service did not start, or it failed",
}


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "demo",
        help="see it work",
        description="Start a service, request two meshes, print their quality and write their files.",
        examples=EXAMPLES,
        exits=EXITS,
    )
    parser.add_argument(
        "--output", metavar="DIR", type=Path, default=Path("demo-output"), help="folder for files (demo-output)"
    )
    parser.add_argument("--port", type=int, default=0, help="port of the service (a free one)")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Start a service, request meshes, report, write files."""
    try:
        import equimesh_service
        from equimesh_service.errors import CannotServeError
        from equimesh_service.settings import Settings
    except ImportError as error:
        raise NotInstalled("service", error) from error
    from equimesh.compiling import Line
    from equimesh_client import Client

    output: Path = options.output
    output.mkdir(parents=True, exist_ok=True)
    with (
        logged(output / "demo.log"),
        tempfile.TemporaryDirectory(prefix="equimesh-demo-", ignore_cleanup_errors=True) as folder,
    ):
        chosen = {
            "host": "127.0.0.1",
            "port": options.port,
            "data_dir": Path(folder),
            "workers": 1,
            "log_level": "warning",
        }
        settings = Settings(**chosen)
        print("Starting a service ...", flush=True)
        with ExitStack() as stack:
            try:
                url = stack.enter_context(equimesh_service.running(settings, line=Line(plain=True)))
            except CannotServeError as error:
                raise CommandError(str(error), Exit.UNREACHABLE) from None
            except OSError as error:
                raise CommandError(start_error(settings, error), Exit.UNREACHABLE) from error
            client = stack.enter_context(Client(url, key=""))
            print(f"It answers at {url}.", flush=True)
            written = [*wave(client, output), *paper(client, output)]
    print(f"\nFiles in {output}:")
    for path in written:
        print(f"  {path.name:<28}{path.stat().st_size:>9} bytes")
    print("\nOpen a .vtu file in ParaView. Most solvers read the .msh, FEniCSx the .xdmf and the files next to it.")
    print("For a function of your own, run `equimesh serve`, and open the page at the address that it tells.")
    return Exit.DONE


@contextmanager
def logged(path: Path) -> Iterator[None]:
    """Write the log of the service to a file, which stays there when something fails, and say so."""
    from equimesh_service.telemetry.logs import formatter

    path.unlink(missing_ok=True)  # that of an earlier failure
    root, handler = logging.getLogger(), logging.FileHandler(path, mode="w", encoding="utf-8", delay=True)
    handler.setFormatter(formatter("text"))
    level = root.level
    root.addHandler(handler)
    root.setLevel(logging.INFO)
    try:
        yield
        path.unlink(missing_ok=True)
    except BaseException:
        if path.exists():  # nothing is logged where the service could not even begin
            print(f"The log is in {path}", file=sys.stderr)
        raise
    finally:
        root.removeHandler(handler)
        root.setLevel(level)
        handler.close()


def wave(client: Client, output: Path) -> list[Path]:
    """The first mesh of the README, with the default settings."""
    heading("1. The mesh of the README: 33 x 33 points, default settings")
    print(f"u(x, y) = {WAVE}", flush=True)
    mesh = client.generate(WAVE, 33, label="demo: a wave")
    print(f"\n{mesh.certificate}\n\nQuality:\n\n{mesh.quality}")
    return write(mesh, output, "wave", plots=("mesh",))


def paper(client: Client, output: Path) -> list[Path]:
    """The paper's mesh on two subdomains, and the convergence of the Schwarz iteration."""
    from equimesh_client import ArcLength, Classical, Schwarz

    heading("2. The paper's mesh: 12 x 12 points, two subdomains that share 4 columns")
    print(f"u(x, y) = {PAPER}", flush=True)
    options: dict[str, Any] = {"monitor": ArcLength(scaled=False), "boundary": "equidistributed_1d"}
    classical = Schwarz(
        overlap=4, transmission=Classical(), ordering="alternating", tolerance=1e-6, compare_single_domain=True
    )
    mesh = client.generate(PAPER, 12, **options, initial="uniform", schwarz=classical, label="demo: the paper")
    print(f"\nClassical Schwarz iteration, error against the mesh of a single domain:\n\n{mesh.convergence}")
    default = Schwarz(subdomains=(3, 2), overlap=2, compare_single_domain=True)
    same = client.generate(PAPER, 12, **options, schwarz=default, label="demo: the paper's, by default settings")
    print(f"\nThe same mesh by the default settings, on 3 x 2 subdomains:\n\n{same.convergence}")
    print(f"\nQuality:\n\n{mesh.quality}")
    return write(mesh, output, "paper", plots=("mesh", "convergence"))


def write(mesh: Mesh, output: Path, name: str, *, plots: tuple[str, ...]) -> list[Path]:
    """Download the mesh in every format of the demonstration, and its pictures."""
    files = [mesh.download(output / f"{name}.{suffix}") for suffix in FORMATS]
    for kind in plots:
        path = output / (f"{name}.png" if kind == "mesh" else f"{name}-{kind}.png")
        mesh.plot(path, kind)
        files.append(path)
    return files


def heading(text: str) -> None:
    """Print a heading."""
    print(f"\n{text}\n{'=' * len(text)}", flush=True)
