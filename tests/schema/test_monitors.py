"""Monitors: what their classes say beyond their fields."""

from __future__ import annotations

from equimesh_schema.document import docs_of, keys_of, types_of
from equimesh_schema.monitors import FUNCTIONS, MONITORS, REQUIRED_FUNCTIONS
from equimesh_schema.sources import functions_of


def test_functions_are_found_by_their_types() -> None:
    assert FUNCTIONS == ("u", "adjoint", "rho", "m11", "m12", "m22")
    assert functions_of(MONITORS.documents["weight"]) == ("rho", "u")
    needing = {kind for kind, names in REQUIRED_FUNCTIONS.items() if names == ("u",)}
    assert needing == {"auto", "least_error", "nodal_solution", "arc_length", "curvature"}
    assert {kind: names for kind, names in REQUIRED_FUNCTIONS.items() if kind not in needing} == {
        "weight": ("rho",),
        "tensor": ("m11", "m12", "m22"),
        "intersection": (),
    }


def test_every_setting_says_what_it_is() -> None:
    for kind, monitor in MONITORS.documents.items():
        assert keys_of(monitor)[0] == "kind"
        assert monitor.USE.endswith(".")
        told = {*docs_of(monitor), "kind", "u"}
        assert told >= {*types_of(monitor)}, kind
