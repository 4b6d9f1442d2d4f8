"""How a solve ended."""

from __future__ import annotations

import equimesh as em


def test_what_counts_as_success() -> None:
    assert {status for status in em.Status if status.succeeded} == {
        em.Status.CONVERGED,
        em.Status.RELAXED,
        em.Status.COMPLETED,
    }


def test_each_status_has_a_sentence_of_its_own() -> None:
    sentences = [status.sentence for status in em.Status]
    assert all(sentence.endswith(".") for sentence in sentences)
    assert len({*sentences}) == len(em.Status)
