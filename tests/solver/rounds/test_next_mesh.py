"""The records of a round."""

from __future__ import annotations

import dataclasses

import equimesh as em
from equimesh.rounds.recovery import NextMesh, Round


def test_a_round_has_all_numbers_of_the_next_mesh() -> None:
    names = {field.name for field in dataclasses.fields(NextMesh)}
    assert names < {field.name for field in dataclasses.fields(Round)}
    assert em.Round is Round


def test_a_round_carries_what_was_chosen() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    found = em.adapt_round(mesh, mesh.x**2)
    assert isinstance(found, Round)
    assert found.chosen in found.candidates
    assert found.gain > 1.0
