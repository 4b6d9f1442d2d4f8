"""Fingerprints, when two requests are equal, and the remedy of checks that take too long."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any, NoReturn

import pytest

from equimesh_service.admission import admit, tasks
from equimesh_service.assembly.samples import convert_mesh
from equimesh_service.errors import TimeLimitError
from equimesh_service.problems.problem import Problem


def test_a_retry_may_meet_a_newer_release(monkeypatch: pytest.MonkeyPatch) -> None:
    admitted = tasks.AdmittedSpec({"label": None, "cells": "quad"}, {}, "digest")
    request, points = admitted.fingerprint("vtu"), admitted.points_fingerprint
    monkeypatch.setattr(tasks, "_VERSION", "next")
    assert admitted.fingerprint("vtu") == request
    assert admitted.points_fingerprint != points  # its points may be other ones


@pytest.mark.parametrize(
    ("function", "remedy"), [(convert_mesh, "send a mesh with fewer cells"), (print, "send fewer samples")]
)
def test_what_takes_too_long_has_a_remedy_for_what_was_sent(function: Any, remedy: str) -> None:
    class SlowWorkers:
        def submit(self, *_arguments: Any, **_limits: Any) -> NoReturn:
            raise TimeLimitError("the time limit was reached")

    admission: Any = SimpleNamespace(side_workers=SlowWorkers(), while_waiting=lambda _: nullcontext())
    with pytest.raises(Problem) as caught:
        admit.ServiceAdmission.work(admission, "/domain/file", function)
    assert remedy in str(caught.value.detail)
