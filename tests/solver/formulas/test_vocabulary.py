"""The vocabulary of formulas and the operations that are known: the same."""

from __future__ import annotations

from equimesh.fields.expression import FUNCTIONS
from equimesh.formulas.jet import OPERATIONS


def test_functions_and_operations_agree() -> None:
    signs = {"+", "-", "*", "/", "**", "negative", "<", "<=", ">", ">=", "==", "!=", "and", "or", "not"}
    assert set(FUNCTIONS) == set(OPERATIONS) - signs
    assert all(description and "\n" not in description for description in FUNCTIONS.values())
