"""A widget of notebooks: a formula with sliders; the browser draws its meshes, and the solver makes them in Python."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from equimesh.domains.domain import UNIT_SQUARE, AnnulusSector, Rectangle
from equimesh.errors import InputError
from equimesh.fields.expression import Expression
from equimesh.meshes.mesh import Mesh
from equimesh.solving.solution import AnySolution
from equimesh.specs.short import grid_of
from equimesh.specs.spec import build
from equimesh_coupling.errors import library
from equimesh_schema.browser.scripts import FOLDER, script

METHODS = ("least_error", "arc_length")
"""The monitors whose meshes a browser computes."""
MAX_POINTS = 129
"""Points a side, at most, of a mesh that follows a slider."""
FIRST_RANGE = 4.0
"""The end of a slider that is given no range, in values of its parameter."""
FIRST = "tanh(k*(y - 0.5 - 0.1*sin(2*pi*x)))"
"""The formula of a widget that is given none, with k = 40."""
_RENDER = """
export default {
  render({ model, el }) {
    let sent = "";
    const root = document.createElement("div");
    // Jupyter takes the arrow keys of a slider, unless the control itself says that it has its own.
    root.addEventListener("focusin", ({ target }) => target.setAttribute("data-lm-suppress-shortcuts", "true"));
    el.append(root);
    const onChange = (state) => {
      sent = JSON.stringify(state);
      model.set("state", state);
      model.save_changes();
    };
    const figure = $figure.createFigure(root, { state: model.get("state"), onChange });
    const follow = () => JSON.stringify(model.get("state")) !== sent && figure.ask(model.get("state"));
    model.on("change:state", follow);
    return () => {
      model.off("change:state", follow);
      figure.end();
    };
  },
};
"""

Range = tuple[float, float]


def widget(
    u: str = FIRST,
    grid: int | tuple[int, int] = 33,
    domain: Rectangle | AnnulusSector = UNIT_SQUARE,
    *,
    monitor: str = "least_error",
    parameters: Mapping[str, float] | None = None,
    ranges: Mapping[str, Range] | None = None,
) -> Any:
    """A formula with a slider for each parameter; the browser draws the uniform and the adapted mesh at once.

    ``widget.mesh`` is the mesh of what the sliders say, and ``widget.solution`` all that is known about it, as
    :func:`equimesh.mesh` makes them: the solver's, not the browser's. ``widget.state`` can be observed and set, as
    any traitlet. ``parameters``, and ``t`` among them, have sliders, whose ends are in ``ranges``.

    Raises :class:`equimesh.MissingLibrary` without anywidget, and :class:`equimesh.InputError`, or its kin, for what
    cannot be used.
    """
    anywidget, traitlets = (
        library(name, install="pip install 'equimesh[notebook]'") for name in ("anywidget", "traitlets")
    )
    if monitor not in METHODS:
        raise InputError(f"monitor = {monitor!r:.40}: choose {' or '.join(METHODS)}", field="monitor")
    values = dict(parameters or ({"k": 40.0} if u == FIRST else {}))
    _formula(u, values)
    counts = grid_of(grid)
    if max(counts.shape) > MAX_POINTS:
        raise InputError(f"grid: a widget has at most {MAX_POINTS} points a side; em.mesh has more", field="grid")
    state = {
        "formula": u,
        "parameters": values,
        "ranges": {name: _range_of(name, value, ranges or {}) for name, value in values.items()},
        "domain": _description(domain),
        "shape": list(counts.shape),
        "method": monitor,
    }
    return _widget_class(anywidget.AnyWidget, traitlets.Dict)(state=state)


def _formula(u: str, values: Mapping[str, float]) -> dict[str, Any]:
    """The formula as in a request, in which t is no parameter; refuses one that is not in the language."""
    others = {name: value for name, value in values.items() if name != "t"}
    t = values.get("t", 0.0)
    Expression(u, parameters=others, t=t)
    return {"expression": u, "parameters": others, "t": t}


def module_text() -> str:
    """The module that draws a widget in a browser."""
    return script() + _RENDER


def _range_of(name: str, value: float, ranges: Mapping[str, Range]) -> dict[str, float]:
    ends = (0.0, FIRST_RANGE * value) if value else (-1.0, 1.0)
    low, high = ranges.get(name, (min(ends), max(ends)))
    if not low < high:
        raise InputError(f"ranges[{name!r}] = ({low}, {high}): the second end must be greater", field="ranges")
    return {"min": low, "max": high}


def _description(domain: object) -> dict[str, Any]:
    """The domain as in a request."""
    if isinstance(domain, Rectangle) and domain.periodic is None:
        return {"x": list(domain.x), "y": list(domain.y)}
    if isinstance(domain, AnnulusSector) and not domain.closed:
        ends = {"center": domain.center, "radii": domain.radii, "angles": domain.angles}
        return {"kind": "annulus_sector", **{name: list(pair) for name, pair in ends.items()}}
    raise InputError("a widget draws rectangles and sectors of rings, without closed lines", field="domain")


@lru_cache
def _widget_class(base: Any, dictionary: Any) -> Any:
    """The class of widgets, which needs a library."""

    class MeshWidget(base):  # type: ignore[misc]
        """See :func:`widget`."""

        _esm = module_text()
        _css = (FOLDER / "figure.css").read_text(encoding="utf-8")
        state = dictionary().tag(sync=True)

        @property
        def solution(self) -> AnySolution:
            """The solver's solution for the state; it is solved when the state has changed."""
            return _solved(json.dumps(self.state, sort_keys=True))

        @property
        def mesh(self) -> Mesh:
            """The solver's mesh for the state."""
            return self.solution.mesh

    return MeshWidget


@lru_cache(maxsize=8)
def _solved(text: str) -> AnySolution:
    """The solution for a state, as JSON."""
    state = json.loads(text)
    n_xi, n_eta = state["shape"]
    spec = {
        "monitor": {"kind": state["method"], "u": _formula(state["formula"], state["parameters"])},
        "domain": state["domain"],
        "grid": {"n_xi": n_xi, "n_eta": n_eta},
    }
    return build(spec).solve()
