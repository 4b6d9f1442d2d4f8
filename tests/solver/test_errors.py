"""The errors of the solver: one tree, each part of which is drawn, exported, and can be sent to another process."""

from __future__ import annotations

import pickle

import pytest

import equimesh as em
from equimesh import errors


def test_every_error_is_one_of_equimesh_and_stands_in_the_drawing() -> None:
    found = [thing for thing in vars(errors).values() if isinstance(thing, type) and issubclass(thing, Exception)]
    assert {em.SolveError, *found} == {
        em.EquimeshError,
        em.InputError,
        em.ExpressionError,
        em.SamplesError,
        em.DecompositionError,
        em.SolveError,
    }
    for error in (em.SolveError, *found):
        assert issubclass(error, em.EquimeshError)
        assert error.__name__ in str(errors.__doc__)
    assert issubclass(em.InputError, ValueError)


@pytest.mark.parametrize("kind", [em.InputError, em.SamplesError, em.DecompositionError])
def test_an_input_error_carries_its_field(kind: type[em.InputError]) -> None:
    error = pickle.loads(pickle.dumps(kind("too few", field="grid.n_xi")))
    assert (type(error), error.message, error.field, str(error)) == (kind, "too few", "grid.n_xi", "too few")


def test_an_expression_error_carries_its_position() -> None:
    position = em.Position(offset=9, line=2, column=6)
    error = pickle.loads(pickle.dumps(em.ExpressionError("no", position=position, field="expression")))
    assert (error.position, error.field) == (position, "expression")
