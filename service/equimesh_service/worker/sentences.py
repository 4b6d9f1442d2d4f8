"""What a certificate says, in sentences for people."""

from collections.abc import Iterator, Mapping
from typing import Any, Literal, TypedDict

from equimesh_schema import Relaxed
from equimesh_schema.certificate import compared

# The names of errors by their norms.
ERRORS = {"l2": "The error", "h1": "The error of the gradient"}


class Sentence(TypedDict):
    """One sentence.

    Its tone is ``good`` or ``bad`` for the worth of the mesh, ``warning`` for what to know before the mesh is used, and
    ``note`` for everything else.
    """

    tone: Literal["good", "bad", "warning", "note"]
    text: str


def sentences_of(
    certificate: Mapping[str, Any],
    norm: str = "l2",
    error: Mapping[str, Any] | None = None,
    *,
    before: Literal["uniform", "initial"] = "uniform",
) -> list[Sentence]:
    """Why the solve failed, what the mesh is worth, and every relaxation and warning of its certificate.

    The worth is that in ``norm``, ``"l2"`` or ``"h1"``; ``error`` is the problem of a failed solve. Grids are compared
    with the uniform mesh, blocks with their initial one: ``before`` is the word for it.
    """
    return [
        *_about_failure(error),
        *_about_gain(certificate, norm, before),
        *_about_request(certificate),
        *_notes(certificate),
    ]


def _about_failure(error: Mapping[str, Any] | None) -> Iterator[Sentence]:
    if error is not None:
        yield {"tone": "bad", "text": f"{error['title']}. {error['detail']} {error['remedy']}"}


def _about_gain(certificate: Mapping[str, Any], norm: str, before: str) -> Iterator[Sentence]:
    gains = certificate["interpolation_gain"]
    if gains is None:
        yield {"tone": "note", "text": "There is no u, so no interpolation error is measured."}
        return
    gain = gains[norm]
    if not gain:
        return  # a warning or the failure says why it is not known
    one = "the initial" if before == "initial" else "a uniform"
    here, word = compared(gain)
    if word == "as":
        yield {"tone": "note", "text": f"{ERRORS[norm]} is that of the {before} mesh."}
    else:
        yield {"tone": "good" if gain > 1.0 else "bad", "text": f"{ERRORS[norm]} is {here} than on {one} mesh."}


def _about_request(certificate: Mapping[str, Any]) -> Iterator[Sentence]:
    """Whether a requested error was reached, which monitor was chosen, and how formulas were understood."""
    target = certificate.get("target")
    if target is not None:
        (n_xi, n_eta), requested, reached = target["grid"], target["error"], target["reached"]
        is_reached = reached <= requested
        text = f"An error of {requested:.2g} was requested, and {n_xi} x {n_eta} points have {reached:.2g}."
        yield {"tone": "good" if is_reached else "bad", "text": text}
    chosen = next((one for one in certificate.get("comparison", ()) if one["chosen"]), None)
    if chosen is not None and chosen["kind"] != "nodal_solution":
        name = chosen["kind"].replace("_", " ")
        yield {"tone": "note", "text": f"Of the monitors that were compared, {name} was chosen."}
    for place, text in certificate.get("understood", {}).items():
        yield {"tone": "note", "text": f"What was typed was read as {place.rpartition('.')[2]} = {text}."}


def _notes(certificate: Mapping[str, Any]) -> Iterator[Sentence]:
    """Relaxations that no warning names, and the warnings."""
    warnings = certificate["warnings"]
    for entry in certificate["relaxed"]:
        relaxed = str(Relaxed(**entry))
        if not any(relaxed in warning for warning in warnings):
            yield {"tone": "note", "text": f"Relaxed: {relaxed}."}
    for warning in warnings:
        yield {"tone": "warning", "text": warning}
