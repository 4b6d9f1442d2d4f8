"""The log context of a request."""

from __future__ import annotations

import re

from equimesh_service.telemetry.log_context import LogContext, choose_request_id, current, enter


def test_ids_of_clients_are_taken_when_they_are_sane() -> None:
    for good in ("a", "Run_7.b:c-d", "x" * 64):
        assert choose_request_id(good) == good
    for bad in (None, "", "x" * 65, "a b", "a\n", "ä", 'a"b'):
        assert re.fullmatch("[0-9a-f]{24}", choose_request_id(bad))
    assert choose_request_id(None) != choose_request_id(None)


def test_a_context_lasts_as_long_as_its_with() -> None:
    outer, inner = LogContext(request_id="r-1"), LogContext(request_id="r-2", mesh_id="m-1")
    with enter(outer):
        with enter(inner):
            assert current() is inner
        assert current() is outer
        outer.key_id = "k-1"  # known later than the request
        assert current().to_fields() == {"request_id": "r-1", "key_id": "k-1"}
    assert current().to_fields() == {}
