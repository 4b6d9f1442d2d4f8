"""The command `deploy/site`: builds the site with Sphinx, every warning an error, and checks the links of its pages."""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

from sphinx.cmd.build import build_main

from generator.checks import broken_links
from generator.places import ROOT
from generator.staging import stage

OUTPUT = ROOT / "service" / "equimesh_service" / "site"
# What Sphinx leaves behind for the next build, which no reader needs.
_LEFTOVERS = (".buildinfo", ".buildinfo.bak", "objects.inv", "_static/_sphinx_javascript_frameworks_compat.js")


def main(arguments: list[str] | None = None) -> int:
    """Build the site; returns 0, or 1 when a page has a fault, which is printed."""
    parser = argparse.ArgumentParser(prog="deploy/site", description="Build the site from docs/.")
    parser.add_argument("--output", type=Path, default=OUTPUT, help="folder, emptied first (default: %(default)s)")
    parser.add_argument("--external", action="store_true", help="only ask whether links to other sites answer")
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        source, built = Path(folder, "pages"), Path(folder, "site")
        source.mkdir()
        try:
            stage(source)
        except ValueError as error:
            print(error, file=sys.stderr)
            return 1
        builder = "linkcheck" if given.external else "html"
        if run_sphinx(source, built, builder) != 0:
            return 1
        if given.external:
            return 0
        faults = broken_links(built)
        if faults:
            print(*faults, sep="\n", file=sys.stderr)
            return 1
        install(built, given.output)
    print(f"The site is in {given.output}.")
    return 0


def run_sphinx(source: Path, built: Path, builder: str = "html", *more: str) -> int:
    """Run Sphinx on staged pages, with all warnings as errors and ``more`` options; returns its exit code."""
    options = ["-q", "-W", "--keep-going", "-n", "-b", builder, "-c", str(ROOT / "docs"), *more]
    return int(build_main([*options, "-d", f"{built}.doctrees", str(source), str(built)]))


def install(built: Path, output: Path) -> None:
    """Move a built site to its folder, in place of what was there."""
    for name in _LEFTOVERS:
        (built / name).unlink(missing_ok=True)
    shutil.rmtree(output, ignore_errors=True)
    shutil.copytree(built, output)
