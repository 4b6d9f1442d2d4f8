"""The kinds of problems."""

from __future__ import annotations

import httpx

from equimesh_service.problems.problem import KINDS


def test_every_problem_explains_itself(http: httpx.Client) -> None:
    for kind in KINDS.values():
        assert http.get(kind.type).json() == {
            "type": kind.type, "title": kind.title, "status": kind.status, "remedy": kind.remedy,
        }  # fmt: skip
