"""`equimesh check`: the faults of an expression."""

import argparse
import importlib.util
import json
from typing import Any

from equimesh_cli.options.mesh import add_parameters
from equimesh_cli.options.monitors import domain, domain_file
from equimesh_cli.options.service import DEFAULT_URL, add_url
from equimesh_cli.parser import Exit, add_command

EXAMPLES = """\
examples:
  equimesh check '(1-exp(15*(x-1)))*sin(pi*y)'
  equimesh check 'tanh(c*(x-y))' --parameter c=30
  equimesh check 'sin(pi*x' --url http://127.0.0.1:8000

"""
EXITS = {
    Exit.DONE: "the expression can be used",
    Exit.INPUT: "it cannot, or bad usage",
    Exit.UNREACHABLE: "no service answers, or it failed",
}


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "check",
        help="check an expression",
        description="Parse an expression and evaluate it on a domain. Works here when the solver is "
        "installed and no --url is given, otherwise through a service.",
        examples=EXAMPLES,
        exits=EXITS,
    )
    parser.add_argument("u", metavar="EXPR", help="u(x, y)")
    add_parameters(parser)
    domains = parser.add_mutually_exclusive_group()
    domains.add_argument(
        "--domain", type=domain, help="rectangle:X0,X1,Y0,Y1, annulus:R0,R1,ANGLE0,ANGLE1 or @FILE (the unit square)"
    )
    domains.add_argument(
        "--domain-file", dest="domain", metavar="FILE", type=domain_file, help="a mesh of quadrilaterals, or blocks"
    )
    add_url(parser, default=None)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Check in this process or at a service, and print the report."""
    local = options.url is None and importlib.util.find_spec("scipy") is not None
    report = _check_here(options) if local else _check_at_service(options)
    print("ok")
    if report.get("understood", options.u) != options.u:
        print(f"  understood: {report['understood']}")
    for name in ("names", "u", "gradient", "constant"):
        if name in report:
            print(f"  {name}: {_words(report[name])}")
    return Exit.DONE


def _check_here(options: argparse.Namespace) -> dict[str, Any]:
    from equimesh_cli.options.problem import build_expression

    expression, domain = build_expression(options)
    return expression.summary(domain=domain)


def _check_at_service(options: argparse.Namespace) -> dict[str, Any]:
    from equimesh_client import Client

    with Client(options.url or DEFAULT_URL, key=options.key, retries=2) as client:
        return client.check(options.u, parameters=dict(options.parameter), t=options.t, domain=options.domain)


def _words(value: Any) -> str:
    if isinstance(value, dict) and value.keys() == {"min", "max"}:
        return f"{value['min']:.6g} to {value['max']:.6g}"
    if isinstance(value, bool):
        return "yes, the mesh will be uniform" if value else "no"
    if isinstance(value, list) and all(isinstance(v, str) for v in value):
        return ", ".join(value) or "none"
    return json.dumps(value)
