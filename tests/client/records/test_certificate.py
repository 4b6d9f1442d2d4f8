"""Certificates, from JSON to words."""

from __future__ import annotations

from typing import Any


def test_a_relaxed_mesh_says_so(connect: Any, service: Any) -> None:
    client = connect(service.url)
    plain = client.generate("x", 8)
    assert (plain.certificate, plain.relaxed, plain.warnings) == (None, False, ())
    mesh = client.generate("x", 8, label="relaxed")
    assert mesh.relaxed
    assert mesh.warnings == ("The mesh adapts less than requested.",)
    assert mesh.certificate.interpolation_gain == {"l2": 5.4, "h1": 2.4}
    assert (mesh.certificate.relaxed[0].what, mesh.certificate.relaxed[0].reached) == ("a", 0.35)
    said = str(mesh.certificate)
    for words in ("relaxed", "a of the arc length: 0.7 requested, 0.35 reached", "5.4 in L2", "warning: The mesh"):
        assert words in said
