"""The widget of notebooks, with a library that only keeps the state: what its mesh is, and what is refused."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import equimesh as em

U = "tanh(k*(x - y) + t)"


class Trait:
    """A trait without checks."""

    def tag(self, **_: Any) -> Any:
        return self


class AnyWidget:
    """A widget without a front end."""

    def __init__(self, **traits: Any) -> None:
        for name, value in traits.items():
            setattr(self, name, value)


@pytest.fixture
def libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, held in (("anywidget", {"AnyWidget": AnyWidget}), ("traitlets", {"Dict": Trait})):
        module = ModuleType(name)
        vars(module).update(held)
        monkeypatch.setitem(sys.modules, name, module)


@pytest.mark.usefixtures("libraries")
def test_the_mesh_of_a_widget_is_that_of_its_sliders() -> None:
    made = em.widget(U, 9, em.Rectangle(x=(0, 2)), parameters={"k": 20, "t": 0.1}, ranges={"k": (5, 100)})
    assert made.state["ranges"] == {"k": {"min": 5, "max": 100}, "t": {"min": 0.0, "max": 0.4}}
    assert made.mesh is made.mesh
    made.state = {**made.state, "parameters": {"k": 5, "t": -0.5}, "method": "arc_length"}
    domain = em.Rectangle(x=(0, 2))
    expected = em.mesh(U, 9, domain, monitor="arc_length", parameters={"k": 5}, t=-0.5, progress=False)
    assert np.array_equal(made.mesh.x, expected.mesh.x)
    assert made.solution.certificate.interpolation_gain == expected.certificate.interpolation_gain


@pytest.mark.usefixtures("libraries")
@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"u": "tanh(q*x)"}, "'q' is not a known name"),
        ({"grid": 500}, "at most 129 points a side"),
        ({"monitor": "curvature"}, "choose least_error or arc_length"),
        ({"ranges": {"k": (3, 3)}}, "the second end must be greater"),
        ({"domain": em.Rectangle(periodic="x")}, "without closed lines"),
        ({"domain": em.AnnulusSector(closed=True)}, "without closed lines"),
    ],
)
def test_what_a_widget_cannot_show_is_refused(settings: dict[str, Any], sentence: str) -> None:
    assert em.widget(domain=em.AnnulusSector()).state["domain"]["radii"] == [1.0, 2.0]
    with pytest.raises(em.InputError, match=sentence):
        em.widget(**settings)


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "anywidget", None)
    with pytest.raises(em.MissingLibrary, match=r"this needs anywidget, which .*: pip install 'equimesh\[notebook\]'"):
        em.widget()
