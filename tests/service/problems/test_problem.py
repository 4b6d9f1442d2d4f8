"""The kinds of problems."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from pydantic import BaseModel, TypeAdapter

from equimesh_schema.document import Document
from equimesh_schema.mesh import ExpressionCheck, MeshSpec
from equimesh_schema.sequences import StepSpec
from equimesh_service.api.meshes import _Page
from equimesh_service.problems.problem import KINDS, Problem, did_you_mean, sentence_of
from equimesh_service.spec.strict import validate
from service.assembly.specs import DOMAINS, MONITORS


def test_every_problem_explains_itself(http: httpx.Client) -> None:
    for kind in KINDS.values():
        assert http.get(kind.type).json() == {
            "type": kind.type, "title": kind.title, "status": kind.status, "remedy": kind.remedy,
        }  # fmt: skip


# Every fault that a model or a parameter can have has a sentence of ours.


# The faults of each type of value, as pydantic names them; other types of values need an entry here.
FAULTS = {
    "bool": {"bool_type", "bool_parsing"},
    "float": {"float_type", "float_parsing", "finite_number", "greater_than", "greater_than_equal", "less_than_equal"},
    "int": {"int_type", "int_parsing", "int_parsing_size", "int_from_float", "greater_than_equal", "less_than_equal"},
    "str": {"string_type", "string_too_long", "string_pattern_mismatch", "string_unicode"},
    "list": {"list_type", "too_short", "too_long"},
    "dict": {"dict_type", "too_long"},
    "literal": {"literal_error"},
    "model": {"model_type"},
    "model-fields": set(),  # missing and extra_forbidden get the sentences of their models
    "model-field": set(),
    "dataclass": {"dataclass_type"},
    "dataclass-args": set(),  # missing and unexpected_keyword_argument, as of a model
    "dataclass-field": set(),
    "tagged-union": set(),  # by_kind and by_key have sentences of their own
    "union": set(),
    "custom-error": set(),  # the sentence of either
    "nullable": set(),
    "any": set(),  # the monitor of a step: it is checked as that of a spec
    "none": set(),
    "default": set(),
    "function-before": set(),
    "function-wrap": set(),
    "definitions": set(),
    "definition-ref": set(),
    "function-plain": set(),
}
CONTEXT = {
    "max_length": 2, "pattern": "^a$", "expected": "'a' or 'b'", "field_type": "List", "gt": 0.0, "ge": 1, "le": 2,
}  # fmt: skip
OTHERS: list[Any] = [None, True, 3, -2.5, 10**400, float("nan"), "text", "x" * 5000, "\0", [], [1, 2, 3], ["a"], {}]
OTHERS += [{"kind": "none"}, {"a": 1}, [[1]], [[1, "a"]], 0.5]


def kinds(schema: Any) -> Iterator[str]:
    """The types of values in a schema of pydantic."""
    if isinstance(schema, dict):
        if isinstance(schema.get("type"), str) and schema["type"] not in ("with-info", "no-info"):
            yield schema["type"]
        for key, inner in schema.items():
            if key not in ("metadata", "serialization", "expected", "ref", "config"):
                yield from kinds(inner)
    elif isinstance(schema, list | tuple):
        for inner in schema:
            yield from kinds(inner)


@pytest.mark.parametrize("model", [MeshSpec, ExpressionCheck, StepSpec, _Page])
def test_every_type_of_value_has_sentences(model: type[BaseModel | Document]) -> None:
    found = set(kinds(TypeAdapter(model).core_schema))
    assert {"model", "dataclass"} & found
    assert found <= set(FAULTS), "say here which faults these types have, and add their sentences"
    for kind in found:
        for fault in FAULTS[kind]:
            sentence = sentence_of({"type": fault, "ctx": CONTEXT, "input": "x"})
            assert sentence is not None, fault
            assert "should" not in sentence
            assert sentence.startswith("this ")


def mutated(value: Any) -> Iterator[Any]:
    """The value with another one in each place."""
    yield from OTHERS
    if isinstance(value, dict):
        for key in value:
            yield {name: member for name, member in value.items() if name != key}
            yield {**value, f"{key}x": 1}
            for inner in mutated(value[key]):
                yield {**value, key: inner}
    elif isinstance(value, list):
        for place in range(len(value)):
            for inner in mutated(value[place]):
                yield [*value[:place], inner, *value[place + 1 :]]


SCHWARZ = {
    "subdomains": [2, 1], "overlap": 2, "transmission": {"kind": "linear_robin", "p": 2}, "ordering": "parallel",
    "line_correction": 3, "acceleration": "none", "local_solver": "sweeps", "fallback": False, "tolerance": 1e-6,
    "max_iterations": 5, "compare_single_domain": False,
}  # fmt: skip
DOCUMENTS: list[tuple[type[Document], Any]] = [
    *((MeshSpec, {"monitor": monitor}) for monitor in MONITORS.values()),
    *((MeshSpec, {"monitor": {"u": "x"}, "domain": domain}) for domain in DOMAINS.values()),
    (MeshSpec, {"monitor": {"u": {"grid": {"x": [0, 1], "y": [0, 1], "values": [[0, 1], [2, 3]]}}}}),
    (MeshSpec, {"monitor": {"u": {"nodal": {"x": [[0, 0]], "y": [[0, 1]], "values": [[2, 3]]}}}}),
    (MeshSpec, {"monitor": {"u": {"scattered": {"points": [[0, 1]], "values": [1]}}}, "schwarz": SCHWARZ}),
    (MeshSpec, {"monitor": {"u": {"samples": "s"}}, "label": "a", "grid": {"n_xi": 4}, "mode": "tight"}),
    (MeshSpec, {"monitor": {"u": {"expression": "x", "parameters": {"k": 1}, "t": 0}}, "target": {"error": 1}}),
    (ExpressionCheck, {"expression": "x", "parameters": {"k": 1}}),
    (StepSpec, {"step": 0, "u": {"nodes": [[1, 2]]}, "fields": {"p": [[1, 2]]}}),
]


def test_no_document_gets_a_sentence_of_pydantic() -> None:
    told: set[str] = set()
    for model, document in DOCUMENTS:
        for wrong in mutated(document):
            try:
                validate(model, wrong)
            except Problem as problem:
                told |= {complaint.message for complaint in problem.errors}
    assert len(told) > 40
    for message in told:
        for word in ("should", "Input", "valid ", "Value error", "Extra", "does not fit here"):
            assert word not in message, message


def test_near_words_are_told() -> None:
    assert did_you_mean("curvatur", ["curvature", "weight"]) == "; did you mean 'curvature'?"
    assert did_you_mean("CURVATURE", ["curvature"]) == "; did you mean 'curvature'?"
    assert did_you_mean("xyz", ["curvature"]) == did_you_mean(3, ["curvature"]) == ""
