"""The strict reading of documents, and the short call from a function to its mesh."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pytest

import equimesh as em
from equimesh import InputError
from equimesh.specs.document import Reading, flag, mapping, number, several, text, whole
from equimesh.specs.short import field_of
from equimesh_schema.document import Document, Either, Words, by_key, by_kind


@dataclass(frozen=True, kw_only=True)
class Pair(Document):
    JSON_NAMES: ClassVar = {"b": "other"}
    REFUSED: ClassVar = {"z": "this belongs to a triple"}
    kind: str = "pair"
    a: float
    b: float = 2.0


@dataclass(frozen=True, kw_only=True)
class Empty(Document):
    kind: str = "empty"


@dataclass(frozen=True, kw_only=True)
class Word(Document):
    word: Annotated[str, Words("x", "y")] = "x"


@dataclass(frozen=True, kw_only=True)
class Plain(Document):
    size: Annotated[float | Literal["auto"] | None, Either("a number, auto or null")] = None
    count: int | Literal["auto"] = "auto"
    whole: int | None = None
    is_on: bool = False
    pair: Pair | None = None
    pairs: list[Annotated[Any, by_kind(Pair, Empty)]] = field(default_factory=list)
    given: object = None


def make(*, a: float, b: float = 2.0) -> tuple[float, float]:
    if a < 0:
        raise InputError("a is negative", field="a")
    if b < 0:
        raise InputError("b is negative", field="b")
    return a, b


READING = Reading({Pair: make, Empty: lambda: (), Word: lambda word: word, Plain: dict})
KINDS, KEYS = by_kind(Pair, Empty, default="pair"), by_key(Word)


def read_pair(given: object, path: str = "") -> Any:
    return READING.record(Pair, given, path)


def read_kinds(given: object, path: str = "") -> Any:
    return READING.one_of(KINDS, given, path)


def read_keys(given: object, path: str = "") -> Any:
    return READING.one_of(KEYS, given, path)


def read_plain(given: object, path: str = "") -> Any:
    return READING.record(Plain, given, path)


def test_what_is_absent_has_the_default_of_what_is_made() -> None:
    assert read_pair({"a": 1}) == read_kinds({"a": 1}) == (1.0, 2.0)
    assert read_kinds({"kind": "empty"}) == ()
    assert read_keys({"word": "x"}) == "x"


@pytest.mark.parametrize(
    ("read", "given", "field", "words"),
    [
        (read_pair, [], "at.pair", "a list: an object"),
        (read_pair, {}, "at.pair.a", "needs the key 'a'"),
        (read_pair, {"a": 1, "c": 1}, "at.pair.c", "known are 'a', 'other'"),
        (read_pair, {"a": 1, "othr": 1}, "at.pair.othr", "did you mean 'other'?"),
        (read_pair, {"a": 1, "z": 1}, "at.pair.z", "belongs to a triple"),
        (read_pair, {"a": 1, 3: 1}, "at.pair.3", "no key 3"),
        (read_pair, {"a": "1"}, "at.pair.a", "the text '1': a number"),
        (read_pair, {"a": -1}, "at.pair.a", "negative"),
        (read_pair, {"a": 1, "other": -1}, "at.pair.other", "negative"),
        (read_kinds, {"kind": "pairs"}, "at.pair.kind", "did you mean 'pair'?"),
        (read_kinds, {"kind": []}, "at.pair.kind", "'pair', 'empty'"),
        (read_kinds, {"kind": "empty", "a": 1}, "at.pair.a", "no key 'a'"),
        (read_keys, {"b": 1}, "at.pair", "one of the keys 'word'"),
        (read_keys, 3, "at.pair", "one of the keys"),
        (read_keys, {"a": 1, "word": "x"}, "at.pair.a", "no key 'a'"),
        (read_plain, {"size": "all"}, "at.pair.size", "a number is needed"),
        (read_plain, {"whole": 1.5}, "at.pair.whole", "a whole number is needed"),
        (read_plain, {"is_on": 1}, "at.pair.is_on", "true or false"),
        (read_plain, {"pair": {"a": True}}, "at.pair.pair.a", "a number is needed"),
        (read_plain, {"pairs": [{"kind": "empty"}, {"a": 1}]}, "at.pair.pairs.1.kind", "is missing"),
    ],
)
def test_a_fault_is_refused_with_its_path(read: Any, given: object, field: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        read(given, "at.pair")
    assert caught.value.field == field
    assert words in caught.value.message


def test_values_of_unions_and_lists() -> None:
    for size, count in ((None, "auto"), ("auto", 3), (2, [])):
        assert read_plain({"size": size, "count": count}) == {"size": size, "count": count}
    made = read_plain({"pair": {"a": 3}, "pairs": [{"kind": "empty"}], "whole": None, "given": [1]})
    assert made == {"pair": (3.0, 2.0), "pairs": ((),), "whole": None, "given": [1]}


def test_another_reader_takes_the_place_of_a_union() -> None:
    reading = Reading({Plain: dict}, {types: lambda value, path: f"{path}={value}" for types in (KINDS,)})
    assert reading.value(Annotated[Any, KINDS], 3, "at") == "at=3"


@pytest.mark.parametrize(
    ("read", "good", "bad"),
    [
        (number, [1, 1.5, np.float32(2)], [True, "1", None, float("nan"), float("inf"), 10**400]),
        (whole, [1, np.int64(3)], [1.0, True, "1"]),
        (flag, [True, False], [0, "yes", None]),
        (text, ["", "x"], [1, None, b"x"]),
        (mapping, [{}], [[], "x", None]),
        (lambda value, path: several(number, value, path), [(1.0, 2.0), ()], ["12", 3, [1, "2"]]),
    ],
)
def test_a_reader_takes_its_type_only(read: Any, good: list[Any], bad: list[Any]) -> None:
    assert [read(value, "at") for value in good] == good
    for value in bad:
        with pytest.raises(InputError) as caught:
            read(value, "at")
        assert caught.value.field.startswith("at"), value


FRONT = "tanh(10*(x + y/2 - 0.75))"
AXIS = np.linspace(0.0, 1.0, 33)
VALUES = np.tanh(10 * (AXIS[:, None] + AXIS / 2 - 0.75))
RECTANGLE = em.Rectangle(x=(0.0, 2.0), y=(0.0, 1.0))


def test_it_is_the_solution_of_the_problem() -> None:
    short = em.mesh(FRONT, 9)
    long = em.solve(em.Problem(monitor=em.Auto(u=em.Expression(FRONT)), grid=em.Grid(n_xi=9, n_eta=9)))
    np.testing.assert_array_equal(short.mesh.points, long.mesh.points)
    assert short.gain == long.certificate.solver_gain["l2"] > 1.5


@pytest.mark.parametrize("grid", [(9, 7), em.Grid(n_xi=9, n_eta=7), (np.int64(9), 7)])
def test_settings_are_those_of_the_monitor(grid: Any) -> None:
    found = em.mesh("k*x*y", grid, RECTANGLE, monitor="arc_length", b=0.5, parameters={"k": 3.0})
    monitor = found.problem.monitor
    assert isinstance(monitor, em.ArcLength)
    assert (monitor.b, found.mesh.x.shape, found.mesh.x.max()) == (0.5, (9, 7), 2.0)
    np.testing.assert_array_equal(found.u, 3.0 * found.mesh.x * found.mesh.y)


@pytest.mark.parametrize(
    "u",
    [
        em.Expression(FRONT),
        lambda x, y: np.tanh(10 * (x + y / 2 - 0.75)),
        VALUES,
        VALUES.tolist(),
        (AXIS, AXIS, VALUES),
        {"x": AXIS, "y": AXIS, "values": VALUES},
        (np.stack(np.meshgrid(AXIS, AXIS, indexing="ij"), axis=2).reshape(-1, 2), VALUES.ravel()),
        (*np.meshgrid(AXIS, AXIS, indexing="ij"), VALUES),
    ],
)
def test_forms_of_a_function(u: Any) -> None:
    x, y = np.array([0.3, 0.71]), np.array([0.9, 0.05])
    found = field_of(u).evaluate(x, y)[0]
    np.testing.assert_allclose(found, np.tanh(10 * (x + y / 2 - 0.75)), atol=2e-2)


def test_a_callable_is_sampled_on_the_domain() -> None:
    np.testing.assert_allclose(field_of(lambda x, _: x, RECTANGLE).evaluate(np.array([1.7]), np.array([0.5]))[0], 1.7)


def test_values_of_blocks() -> None:
    uniform = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=5))
    blocks = em.Blocks.of_mesh(uniform.points, uniform.cells, uniform.sides)
    nodes = blocks.mesh.points
    found = em.mesh({"nodes": nodes, "values": nodes[:, 0] ** 2}, domain=blocks, monitor="least_error")
    assert found.status.succeeded
    with pytest.raises(em.InputError, match="leave the grid out") as caught:
        em.mesh("x", 9, blocks)
    assert caught.value.field == "grid"


@pytest.mark.parametrize(
    ("given", "field", "sentence"),
    [
        ({"u": 5}, "u", "u is an expression, an array"),
        ({"u": np.ones(3)}, "u", "an array u has two dimensions"),
        ({"u": lambda x, y: float(x) + y}, "u", r"numpy\.vectorize"),
        ({"u": np.full((3, 3), np.nan)}, "u", "samples must be finite"),
        ({"u": np.ones((3, 3)), "t": 2.0}, "parameters", "belong to a formula"),
        ({"u": "x", "grid": "9"}, "grid", "grid = '9': give a number of points a side"),
        ({"u": "x", "grid": (9.0, 9)}, "grid", "give a number of points a side"),
        ({"u": "x", "grid": ("a", "b")}, "grid", "give a number of points a side"),
        ({"u": "x", "grid": (9, 9, 9)}, "grid", "give a number of points a side"),
        ({"u": "x", "grid": em.Target(error=0.1)}, "grid", r"solve_to\(Target\(\.\.\.\), monitor=Auto\(u\)\)"),
        ({"u": "1/(x - 0.5)"}, "expression", r"not finite at \(x, y\) = \(0\.5, 0\), because of 1/\(x - 0\.5\)"),
        ({"u": "x", "grid": 1}, "grid.n_xi", "at least"),
        ({"u": "x", "monitor": "weight"}, "monitor", "choose one of auto, least_error, arc_length, curvature$"),
        ({"u": "x", "monitor": "least-error"}, "monitor", "perhaps least_error is meant$"),
        ({"u": "x", "monitor": em.Auto(u="x")}, "monitor", r"solve\(Problem\(monitor=\.\.\.\)\) takes"),
        ({"u": "x", "degree": "2"}, "degree", "degree = '2': give"),
        ({"u": em.Expression}, "u", r"u\(x, y\) must take arrays"),
        ({"u": "x", "parameters": 3}, "parameters", "by their names"),
        ({"u": "x", "distrotion": 2.0, "monitor": "least_error"}, "distrotion", "perhaps distortion is meant"),
        ({"u": "x", "mode": "tight"}, "mode", "has no setting 'mode'; it has norm, "),
        ({"u": "x", "points": 400}, "points", r"solve_to\(Target\(error="),
        ({"u": "x", "monitor": "arc_length", "degree": 2}, "degree", "; auto and least_error have it; it has a, b,"),
    ],
)
def test_refusals_say_what_to_do(given: dict[str, Any], field: str, sentence: str) -> None:
    with pytest.raises(em.InputError, match=sentence) as caught:
        em.mesh(**given)
    assert caught.value.field == field


def test_dir_shows_what_people_need() -> None:
    assert dir(em) == sorted(em.__all__)
    assert "mesh" in dir(em)


def test_whole_numbers_may_be_those_of_numpy() -> None:
    two = np.int64(2)
    solution = em.mesh("tanh(9*(x - y))", (np.int64(9), 8), degree=two, orthogonality=np.int64(60))
    assert json.loads(json.dumps(solution.certificate.summary()))["degree"] == 2
    em.Schwarz(subdomains=(two, 1), overlap=two, max_iterations=two)
    em.Target(error=two, max_points=np.int64(1000))
    with pytest.raises(em.InputError, match="whole number"):
        em.mesh("x*y", 9, degree=np.True_)


def test_first_values_are_taken_by_position() -> None:
    u = em.Expression("x*y")
    assert em.Grid(9) == em.Grid(9, 9) == em.Grid(n_xi=9, n_eta=9)
    assert em.Rectangle((0.0, 2.0), (0.0, 1.0)) == RECTANGLE
    for kind in (em.Auto, em.LeastError, em.ArcLength, em.Curvature):
        assert em.Problem(kind(u), em.Grid(9)).monitor.u is u
        with pytest.raises(TypeError, match="positional"):
            kind(u, "h1")  # type: ignore[operator]
