"""The progress of a draft, which the service may put into the store between two looks of its worker."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

from equimesh_service.store.rows import Claim
from equimesh_service.worker.solve import _Presence


class _Arriving:
    """A store into which a draft is entered right after the first look, whatever that look is."""

    def __init__(self) -> None:
        self.is_there = False
        self.drafts = SimpleNamespace(exists=lambda _: self._look())
        self.queue = SimpleNamespace(progress=self._progress)

    def _look(self) -> bool:
        seen, self.is_there = self.is_there, True
        return seen

    def _progress(self, _claim: Claim, _data: Mapping[str, Any]) -> bool:
        return self._look()


def presence(store: Any, *, known: bool) -> _Presence:
    return _Presence(store, Claim("a", 1), known)


def test_a_draft_that_is_entered_between_two_looks_is_not_lost() -> None:
    attempt = presence(_Arriving(), known=False)
    assert [attempt.report({}), attempt.known] == [True, False]
    assert [attempt.report({}), attempt.known] == [True, True]


def test_an_attempt_whose_mesh_was_in_the_store_is_lost_when_it_is_gone() -> None:
    store = _Arriving()
    store.is_there = True
    attempt = presence(store, known=False)
    assert attempt.report({})
    store.is_there = False
    assert not attempt.report({})
    assert not presence(_Arriving(), known=True).report({})  # of a mesh that is no draft
