"""Certificates, from JSON to words."""

from __future__ import annotations

import json
import math

import pytest

from client.fake_service import CERTIFICATE
from equimesh_schema import Certificate


def test_the_gains_of_blocks_refer_to_the_initial_mesh() -> None:
    of_blocks = Certificate.from_json({**CERTIFICATE, "compared_with": "initial"})
    assert (of_blocks.compared_with, Certificate.from_json(CERTIFICATE).compared_with) == ("initial", "uniform")
    assert "(error on the initial mesh over that on this one)" in str(of_blocks)
    assert "uniform" not in str(of_blocks)
    assert "(error on the uniform mesh over that on this one)" in str(Certificate.from_json(CERTIFICATE))


@pytest.mark.parametrize(
    ("gains", "words"),
    [
        (
            {"l2": 25.2, "h1": 5.93},
            "is 25 times smaller than on the uniform mesh; that of its gradient is 5.9 times smaller.",
        ),
        ({"l2": 1.05, "h1": None}, "is 4.8 % smaller than on the uniform mesh."),
        ({"l2": 0.5, "h1": 1.001}, "is 2 times larger than on the uniform mesh; that of its gradient is the same."),
        ({"l2": 0.96, "h1": 1.0}, "is 4.2 % larger than on the uniform mesh; that of its gradient is the same."),
        ({"l2": 1.0, "h1": 2.0}, "is the same as on the uniform mesh; that of its gradient is 2 times smaller."),
        (
            {"l2": 99.6, "h1": 2.0},
            "is 100 times smaller than on the uniform mesh; that of its gradient is 2 times smaller.",
        ),
        ({"l2": None, "h1": 2.0}, "How much smaller the error of interpolation is, is not known."),
        (None, "There is no u, so no error of interpolation is measured."),
    ],
)
def test_the_first_line_says_what_a_mesh_is_worth(gains: dict[str, float | None] | None, words: str) -> None:
    certificate = Certificate.from_json({**CERTIFICATE, "interpolation_gain": gains})
    assert certificate.headline.endswith(words)
    assert str(certificate).splitlines()[0] == certificate.headline


def test_what_a_solver_gets_is_said_first() -> None:
    gains = {"interpolation_gain": {"l2": 22.4, "h1": 5.9}, "solver_gain": {"l2": 8.04, "h1": 5.5, "points": 2401}}
    certificate = Certificate.from_json({**CERTIFICATE, **gains})
    assert certificate.headline == (
        "A solver's error is 8 times smaller than on the uniform mesh; that of interpolating u is 22 times smaller."
    )
    assert "  solver gain           8 in L2, 5.5 in H1  (" in str(certificate)
    assert certificate.solver_gain is not None
    assert (dict(certificate.solver_gain), len(certificate.solver_gain)) == ({"l2": 8.04, "h1": 5.5}, 2)
    worse = {**gains, "solver_gain": {"l2": 0.5, "h1": 1.0, "points": 81}, "compared_with": "initial"}
    said = Certificate.from_json({**CERTIFICATE, **worse}).headline
    assert said.startswith("A solver's error is 2 times larger than on the initial mesh; ")
    unknown = {**gains, "solver_gain": {"l2": None, "h1": None, "points": 81}}
    assert Certificate.from_json({**CERTIFICATE, **unknown}).headline.startswith("The error of interpolating u is 22 ")


def test_a_failed_mesh_has_no_gain_in_its_first_line() -> None:
    failed = Certificate.from_json({**CERTIFICATE, "status": "not_converged"})
    assert failed.headline == "The solve failed: not converged."


def test_what_was_understood_is_told() -> None:
    certificate = Certificate.from_json({**CERTIFICATE, "understood": {"monitor.u": "2*x"}})
    assert certificate.understood == {"monitor.u": "2*x"}
    assert "  read as               monitor.u = 2*x\n" in str(certificate)
    assert "read as" not in str(Certificate.from_json(CERTIFICATE))


def test_a_mesh_of_least_error_has_a_comparison_in_place_of_a_residual() -> None:
    settings = {"norm": "l2", "distortion": 0.5, "smoothness": 1.0}
    best = {"kind": "least_error", "settings": settings, "gain_l2": 12.5, "gain_h1": 3.0, "chosen": True}
    none = {"kind": "curvature", "settings": {}, "gain_l2": None, "gain_h1": None, "chosen": False}
    record = {**CERTIFICATE, "status": "completed", "mode": None, "equation_residual": None, "relaxed": []}
    certificate = Certificate.from_json({**record, "comparison": [best, none]})
    assert certificate.equation_residual is None
    first, second = certificate.comparison
    assert (first.kind, first.settings, first.gain_l2, first.chosen) == ("least_error", settings, 12.5, True)
    assert math.isnan(second.gain_h1)
    said = str(certificate)
    assert "residual" not in said
    assert "least error (norm l2, distortion 0.5, smoothness 1.0): 12 in L2, 3 in H1  (chosen)" in said
    assert "compared              curvature: no valid mesh" in said
    assert Certificate.from_json(record).comparison == ()
    with_cells = Certificate.from_json({**record, "comparison": [{**best, "gain_cells": 2.5}]})
    assert with_cells.comparison[0].gain_cells == 2.5
    assert "2.5 at cell centres, 12 in L2" in str(with_cells)
    assert math.isnan(first.gain_cells)
    lines = {"what": "rectilinear", "asked": 0.0, "reached": 1.0}
    assert "straight lines" in str(Certificate.from_json({**record, "relaxed": [lines]}))
    target = {"norm": "h1", "error": 0.1, "grid": [33, 17], "predicted": 0.098, "reached": 0.097, "solves": 2}
    aimed = Certificate.from_json({**record, "target": target})
    assert (aimed.target.grid, aimed.target.reached, aimed.target.solves) == ((33, 17), 0.097, 2)
    assert "target                0.1 in H1 requested, 0.098 predicted, 0.097 reached on 33 x 17 points" in str(aimed)
    assert certificate.target is None


def test_json_of_a_certificate_is_that_it_was_read_from() -> None:
    assert Certificate.from_json(CERTIFICATE).to_json() == {
        **CERTIFICATE,
        "solver_gain": None,
        "target": None,
        "comparison": [],
        "estimate": None,
        "resolved": True,
        "compared_with": "uniform",
        "understood": {},
        "gains_by_degree": [],
        "degree": 1,
    }


def test_the_gains_of_each_degree_are_told() -> None:
    gains = [{"degree": 1, "l2": 16.8, "h1": 4.9}, {"degree": 2, "l2": 0.456, "h1": None}]
    certificate = Certificate.from_json({**CERTIFICATE, "gains_by_degree": gains})
    assert [(one.degree, one.l2) for one in certificate.gains_by_degree] == [(1, 16.8), (2, 0.456)]
    assert math.isnan(certificate.gains_by_degree[1].h1)
    assert "degree 1: 17 in L2, 4.9 in H1; degree 2: 0.46 in L2, not known in H1" in str(certificate)
    assert certificate.to_json()["gains_by_degree"] == gains
    assert "by degree" not in str(Certificate.from_json(CERTIFICATE))
    of_degree = Certificate.from_json({**CERTIFICATE, "degree": 2})
    assert of_degree.headline.startswith("The error of interpolating u by elements of degree 2 is 5.4 times smaller")


def test_what_is_absent_or_no_number_is_not_known_and_null_again() -> None:
    certificate = Certificate.from_json({"algebraic_error": "much", "interpolation_gain": {"l2": None}, "newer": 1})
    assert math.isnan(certificate.algebraic_error)
    assert math.isnan(certificate.non_orthogonality)
    assert (certificate.status, certificate.mode, certificate.warnings) == ("", None, ())
    written = json.loads(json.dumps(certificate.to_json(), allow_nan=False))
    assert written["interpolation_gain"] == {"l2": None, "h1": None}
    assert written["algebraic_error"] is None
    assert written["relaxed"] == []
