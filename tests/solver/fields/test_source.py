"""Sources: compiled code evaluates them as Python does."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.fields import bicubic
from equimesh.fields.source import fill, source_of

X, Y = np.random.default_rng(5).uniform(-0.1, 1.1, (2, 1300))
AXIS = np.linspace(0.0, 1.0, 9)
FIELDS = [
    em.Expression("tanh(9*(x - y**2)) + erf(x*y)"),
    em.Expression("2*x - 3"),
    em.GridSamples(x=AXIS, y=AXIS**2, values=np.sin(5.0 * AXIS[:, None]) * AXIS),
]


@pytest.mark.parametrize("field", FIELDS, ids=str)
@pytest.mark.parametrize("order", [1, 2])
def test_the_numbers_are_those_of_the_field(field: em.Field, order: int) -> None:
    source, expected = source_of(field, order), field.evaluate(X, Y, order)
    assert source is not None
    for count in (1, 511, X.size):
        rows = np.full((6, count), 7.0)
        fill(source, X[:count].copy(), Y[:count].copy(), rows)
        assert np.array_equal(rows[: len(expected)], np.stack(expected)[:, :count])
        assert (rows[len(expected) :] == 7.0).all()


def test_other_fields_have_none(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=4, n_eta=4))
    assert source_of(em.NodalField(mesh=mesh, values=mesh.x), 1) is None
    monkeypatch.setattr(bicubic, "MAX_PATCHES", 1)
    assert source_of(em.GridSamples(x=AXIS, y=AXIS, values=np.outer(AXIS, AXIS)), 1) is None
