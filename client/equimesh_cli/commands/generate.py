"""`equimesh generate`: a mesh from a service."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING, Any

from equimesh_cli.options.mesh import (
    MESH_SUFFIXES,
    PART_SUFFIXES,
    Picture,
    add_mesh_options,
    check_options,
    picture_of,
    points_of,
    schwarz_of,
    target_of,
)
from equimesh_cli.options.monitors import monitor_of, number_or
from equimesh_cli.options.service import DEFAULT_URL, add_url
from equimesh_cli.parser import CommandError, Exit, add_command
from equimesh_cli.report import told

if TYPE_CHECKING:
    from equimesh_client import Certificate, Client, Mesh

EXAMPLES = """\
examples:
  equimesh generate '(1-exp(15*(x-1)))*sin(pi*y)' -n 64 -o mesh.vtu
  equimesh generate 'tanh(c*(x-y))' --parameter c=30 -n 65 --plot mesh.png
  equimesh generate --samples u.npz -n 129 --subdomains 2x2 --overlap 6 \\
      -o mesh.msh
  equimesh generate 'tanh(20*(x-y))' -n 65 --monitor curvature \\
      --domain annulus:1,2,0,90 -o mesh.vtu
  equimesh generate 'tanh(20*(x-y))' -n 4097 --monitor curvature -o mesh.pvtu
  equimesh generate 'tanh(20*(x-y))' --domain-file cylinder.msh -o mesh.vtu
  equimesh generate x*y -n 33 --url http://meshes.example:8000 --json

"""
EXITS = {
    Exit.FAILED: "the mesh failed: it did not converge, it folded, or it was canceled",
    Exit.INPUT: "bad usage or bad input, or the service refuses the request",
    Exit.UNREACHABLE: "no service answers, it failed, or it has no room: try again later",
    Exit.DEADLINE: "the deadline passed; the mesh was canceled",
    Exit.INTERRUPTED: "interrupted; the mesh was canceled",
}


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "generate",
        help="request a mesh from a service",
        description="Request the mesh that is adapted to u from a service, wait for it, and write it to a file.",
        examples=EXAMPLES,
        exits=EXITS,
        usage="equimesh generate [OPTIONS] [U]",
    )
    add_mesh_options(parser)
    service = parser.add_argument_group("service")
    add_url(service, default=DEFAULT_URL)
    service.add_argument("--deadline", metavar="SECONDS", type=float, default=600.0, help="(600)")
    service.add_argument(
        "--parts",
        metavar="N",
        type=number_or(int, ("auto",)),
        help="parts of the service's cluster, or auto (where the mesh is too large for one machine: auto); -o then is "
        "a .pvtu or .vtkhdf file, with the files of the parts next to it",
    )
    service.add_argument("--label", help="free text, for the service's list of meshes")
    service.add_argument(
        "--no-reuse", action="store_true", help="compute it, even if the service has the mesh of the same request"
    )
    service.add_argument(
        "--no-store", action="store_true", help="let the service keep nothing: the mesh is the file of -o alone"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Request a mesh, wait, download, report."""
    check_options(options, suffixes=(*MESH_SUFFIXES, *PART_SUFFIXES))
    from equimesh_cli.report import print_report
    from equimesh_client import Client, DeadlineExceeded, MeshFailed

    quiet, picture = options.quiet or None, picture_of(options)
    with Client(options.url, key=options.key) as client:
        if options.no_store:
            return _compute_file(client, options)
        try:
            mesh = _request_mesh(client, options, progress=False if quiet else None)
        except MeshFailed as error:
            _report_failure(client, options, error.mesh.record, picture)
            raise
        except DeadlineExceeded as error:
            advice = "The mesh was canceled; give it more time with --deadline, or request fewer points."
            raise CommandError(f"{error}\n{advice}", Exit.DEADLINE) from error
        files = _write(mesh, options, picture)
        if options.json:
            parts = {"quality": mesh.quality.record, "convergence": mesh.convergence.record}
            print(json.dumps({"mesh": mesh.record, **parts, "files": files}, indent=2))
        elif not options.quiet:
            certificate = mesh.certificate
            grid = mesh.record["grid"]
            points = mesh.record["points"] if grid is None else f"{grid['n_xi']} x {grid['n_eta']}"
            print_report(certificate, points, mesh.record["convergence"]["message"])
            print(mesh.quality)
            if options.subdomains is not None:
                print(f"\n{mesh.convergence}")
            print(f"mesh {mesh.id} of {client.url}")
            if mesh.reused_from is not None:
                print(f"computed earlier, as mesh {mesh.reused_from}; --no-reuse computes it again")
            for file in files:
                print(f"wrote {file}")
    if picture is not None and options.open:
        print(told(picture.path), file=sys.stderr)
    return Exit.DONE


def _compute_file(client: Client, options: argparse.Namespace) -> int:
    """Write the file of a mesh that the service does not keep, and report."""
    from equimesh_cli.report import print_report

    if options.output is None or options.output.is_dir() or options.plot is not None or options.open or options.partial:
        raise CommandError("--no-store leaves one file and its certificate: name it by -o FILE, without pictures")
    if options.parts is not None or options.label is not None:
        raise CommandError("--parts and --label are for meshes that the service keeps: leave out --no-store")
    if options.order != 1:
        raise CommandError("--order 2 is for meshes that the service keeps: leave out --no-store")
    certificate = client.compute_file(options.output, **_arguments(options))
    if options.json:
        known = None if certificate is None else certificate.to_json()
        print(json.dumps({"certificate": known, "files": [str(options.output)]}, indent=2))
    elif not options.quiet:
        print_report(certificate, _points_of(options, certificate), "The service keeps nothing of it.")
        print(f"wrote {options.output}")
    return Exit.DONE


def _points_of(options: argparse.Namespace, certificate: Certificate | None) -> str:
    """The points of a mesh of which only the certificate is known; empty where that does not tell them."""
    from equimesh_client.spec.domains import has_own_points

    aim = None if certificate is None else certificate.target
    if aim is None and (has_own_points(options.domain) or target_of(options) is not None):
        return ""
    return " x ".join(map(str, points_of(options) if aim is None else aim.grid))


def _report_failure(
    client: Client, options: argparse.Namespace, record: dict[str, Any], picture: Picture | None
) -> None:
    """Write and report the partial mesh of a failed solve."""
    files = []
    if options.partial and record.get("partial"):
        files = _write(client.meshes.get(str(record["id"])), options, picture, partial=True)
    if options.json:
        print(json.dumps({"mesh": record, "files": files}, indent=2))
    elif not options.quiet:
        for file in files:
            print(f"wrote {file}, a partial mesh")


def _write(mesh: Mesh, options: argparse.Namespace, picture: Picture | None, *, partial: bool = False) -> list[str]:
    """Write the requested files and return their names."""
    files = []
    if options.output is not None:
        files.append(
            str(mesh.download(options.output, order=options.order, partial=partial, deadline=options.deadline))
        )
    if picture is not None:
        mesh.plot(picture.path, picture.kind, deadline=options.deadline)
        files.append(str(picture.path))
    return files


def _request_mesh(client: Client, options: argparse.Namespace, *, progress: bool | None) -> Mesh:
    kept = {"parts": options.parts, "label": options.label}
    return client.generate(**_arguments(options), **kept, reuse=not options.no_reuse, progress=progress)


def _arguments(options: argparse.Namespace) -> dict[str, Any]:
    """The arguments of the client for a mesh that is kept or not."""
    from equimesh_client import SampleFile

    samples = options.samples if options.column is None else SampleFile(options.samples, options.column)
    return {
        "u": options.u if samples is None else samples,
        "n": points_of(options),
        "monitor": monitor_of(options),
        "domain": options.domain,
        "schwarz": schwarz_of(options),
        "target": target_of(options),
        "boundary": options.boundary,
        "initial": options.initial,
        "mode": options.mode,
        "allow_relaxed": not options.no_relax,
        "cells": options.cells,
        "parameters": dict(options.parameter),
        "t": options.t,
        "deadline": options.deadline,
    }
