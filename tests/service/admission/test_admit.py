"""Fingerprints: when two requests are equal."""

from __future__ import annotations

import pytest

from equimesh_service.admission import admit


def test_a_retry_may_meet_a_newer_release(monkeypatch: pytest.MonkeyPatch) -> None:
    admitted = admit.Admitted({"label": None, "cells": "quad"}, {}, "digest")
    request, points = admitted.fingerprint("vtu"), admitted.points_fingerprint
    monkeypatch.setattr(admit, "_VERSION", "next")
    assert admitted.fingerprint("vtu") == request
    assert admitted.points_fingerprint != points  # its points may be other ones
