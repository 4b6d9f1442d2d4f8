"""Schwarz settings of a document."""

from __future__ import annotations

from typing import Any

import pytest

from equimesh import Classical, InputError, LinearRobin, NonlinearRobin, Optimized, Schwarz, TransmissionCondition
from equimesh.specs import build_schwarz


def test_a_document_without_settings_is_of_a_single_domain() -> None:
    assert build_schwarz({}) is None
    assert build_schwarz({"schwarz": None, "grid": {"n_xi": 5}}) is None
    assert build_schwarz({"schwarz": {}}) == Schwarz()
    assert build_schwarz({"schwarz": {"subdomains": [[24, 40], 1]}}) == Schwarz(subdomains=((24, 40), 1))


@pytest.mark.parametrize(
    ("document", "condition"),
    [
        ({"kind": "optimized", "data": "local"}, Optimized(data="local")),  # type: ignore[arg-type]
        ({"kind": "classical"}, Classical()),
        ({"kind": "linear_robin"}, LinearRobin()),
        ({"kind": "linear_robin", "p": 2}, LinearRobin(p=2.0)),
        ({"kind": "nonlinear_robin", "p": "auto"}, NonlinearRobin()),
    ],
)
def test_every_condition_is_built(document: dict[str, Any], condition: TransmissionCondition) -> None:
    schwarz = build_schwarz({"schwarz": {"transmission": document, "subdomains": [3, 2], "tolerance": None}})
    assert schwarz == Schwarz(transmission=condition, subdomains=(3, 2), tolerance=None)


@pytest.mark.parametrize(
    ("settings", "field"),
    [
        ([], "schwarz"),
        ({"subdomain": [2, 1]}, "schwarz.subdomain"),
        ({"subdomains": 2}, "schwarz.subdomains"),
        ({"subdomains": [0, 1]}, "schwarz.subdomains"),
        ({"subdomains": [[24, 63], 1]}, "schwarz.subdomains"),
        ({"subdomains": [[[24]], 1]}, "schwarz.subdomains"),
        ({"overlap": 64}, "schwarz.overlap"),
        ({"overlap": 1}, "schwarz.overlap"),
        ({"overlap": 2.0}, "schwarz.overlap"),
        ({"transmission": "classical"}, "schwarz.transmission"),
        ({"transmission": {"kind": "classical", "p": 1}}, "schwarz.transmission.p"),
        ({"transmission": {"kind": "linear_robin", "p": -1}}, "schwarz.transmission.p"),
        ({"transmission": {"kind": "linear_robin", "p": True}}, "schwarz.transmission.p"),
        ({"transmission": {"kind": "optimized", "data": "all"}}, "schwarz.transmission.data"),
        ({"ordering": "random"}, "schwarz.ordering"),
        ({"ordering": ["parallel"]}, "schwarz.ordering"),
        ({"acceleration": "aitken"}, "schwarz.acceleration"),
        ({"local_solver": None}, "schwarz.local_solver"),
        ({"line_correction": 11}, "schwarz.line_correction"),
        ({"fallback": "no"}, "schwarz.fallback"),
        ({"tolerance": 0}, "schwarz.tolerance"),
        ({"tolerance": "low"}, "schwarz.tolerance"),
        ({"max_iterations": 0}, "schwarz.max_iterations"),
        ({"compare_single_domain": 1}, "schwarz.compare_single_domain"),
    ],
)
def test_a_fault_has_the_path_of_the_document(settings: object, field: str) -> None:
    with pytest.raises(InputError) as caught:
        build_schwarz({"schwarz": settings})
    assert caught.value.field == field


def test_settings_are_refused_before_the_grid_is_read() -> None:
    with pytest.raises(InputError) as caught:
        build_schwarz({"grid": {"n_xi": 3}, "schwarz": {"line_correction": 12}})
    assert caught.value.field == "schwarz.line_correction"
    assert build_schwarz({"grid": {"n_xi": 3}}) is None


@pytest.mark.parametrize("kind", ["least_error", "auto", "arc_length"])
def test_every_monitor_has_settings_of_its_own(kind: str) -> None:
    document = {"monitor": {"kind": kind, "u": "x"}}
    given = {"max_exchanges": 3} if kind == "least_error" else {"max_iterations": 3}
    other = {"max_iterations": 3} if kind == "least_error" else {"max_exchanges": 3}
    assert build_schwarz({**document, "schwarz": given}) == Schwarz(**given)
    with pytest.raises(InputError, match="leave it out") as caught:
        build_schwarz({**document, "schwarz": other})
    assert caught.value.field == f"schwarz.{next(iter(other))}"
