"""Schwarz settings of the client, and their JSON."""

from __future__ import annotations

import pytest

from equimesh_client import BadArgument, BlockSchwarz, LinearRobin, Schwarz
from equimesh_client.spec.request import mesh_spec


def test_schwarz_as_json() -> None:
    schwarz = mesh_spec({}, 8, {"schwarz": Schwarz(transmission=LinearRobin(2.3), tolerance=None)})["schwarz"]
    assert schwarz == {
        "subdomains": [2, 1],
        "overlap": 4,
        "transmission": {"kind": "linear_robin", "p": 2.3},
        "ordering": "parallel",
        "line_correction": "auto",
        "acceleration": "auto",
        "local_solver": "sweeps",
        "fallback": True,
        "tolerance": None,
        "max_iterations": 100,
        "compare_single_domain": False,
    }
    assert mesh_spec({}, 8, {"schwarz": {"overlap": 3}})["schwarz"] == {"overlap": 3}
    assert Schwarz(subdomains=((24, 40), 1)).to_json()["subdomains"] == [[24, 40], 1]


def test_the_iteration_between_blocks_as_json() -> None:
    schwarz = mesh_spec({}, options={"schwarz": BlockSchwarz(groups=(("in", 2), ("top",)))}, n=8)["schwarz"]
    assert schwarz == {"overlap": 4, "local_steps": 8, "max_exchanges": None, "groups": [["in", 2], ["top"]]}
    assert BlockSchwarz().to_json()["groups"] is None
    with pytest.raises(BadArgument, match="on blocks a BlockSchwarz"):
        mesh_spec({}, 8, {"schwarz": 3})  # type: ignore[typeddict-item]


def test_what_is_no_condition_is_refused() -> None:
    wrong = Schwarz(transmission="classical")  # type: ignore[arg-type]
    with pytest.raises(BadArgument, match="transmission = 'classical': give Optimized"):
        mesh_spec({}, 8, {"schwarz": wrong})
