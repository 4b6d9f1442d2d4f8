"""What is told of a mesh: what it is worth comes first."""

from __future__ import annotations

import pytest

from client.fake_service import CERTIFICATE
from equimesh_cli.report import print_report
from equimesh_client import Certificate


def test_the_gain_comes_first_then_the_warnings_then_the_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    certificate = Certificate.from_json(CERTIFICATE)
    print_report(certificate, "8 x 8", "The mesh is valid.")
    first, second, third, blank, heading, *details = capsys.readouterr().out.splitlines()
    assert first == certificate.headline
    assert "5.4 times smaller than on the uniform mesh" in first
    assert second == "8 x 8 points. The mesh is valid."
    assert third == f"warning: {certificate.warnings[0]}"
    assert (blank, heading) == ("", "Details:")
    assert details == certificate.details.splitlines()
    assert not any("warning" in line for line in details)


def test_without_a_certificate_the_end_of_the_solve_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    print_report(None, 64, "The mesh is finished.")
    assert capsys.readouterr().out == "64 points: The mesh is finished.\n"
