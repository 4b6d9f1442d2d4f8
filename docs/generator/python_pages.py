"""The pages of the Python reference: one for each package with public names, in reStructuredText for autodoc."""

from __future__ import annotations

import importlib
import inspect
from enum import Enum

from generator.faces import FACES, Name, comment_of, groups, public_names

FOLDER = "reference/packages"


def python_pages() -> dict[str, str]:
    """The text of each page by its name on the site; the first one is the list of all packages."""
    pages = {f"{FOLDER}/index.md": _index()}
    return pages | {f"{FOLDER}/{face}.rst": _page(face) for face in FACES}


def first_sentence(value: object) -> str:
    """The first paragraph of a docstring on one line."""
    return " ".join((inspect.getdoc(value) or "").split("\n\n")[0].split())


def _index() -> str:
    lines = ["# Python packages", "", "Made from the docstrings: every public name, with its types.", ""]
    for face in FACES:
        sentence = first_sentence(importlib.import_module(face)).replace("``", "`")
        lines.append(f"- [`{face}`]({face}.rst): {_plain(sentence).rstrip(':')}")
    return "\n".join([*lines, ""])


def _plain(sentence: str) -> str:
    """A sentence without the roles of reStructuredText."""
    words = sentence.split(":func:")
    return "".join(words).replace(":class:", "")


def _page(face: str) -> str:
    module = importlib.import_module(face)
    lines = [_heading(face, "="), f".. py:module:: {face}", f".. py:currentmodule:: {face}", ""]
    lines += [inspect.getdoc(module) or "", ""]
    for heading, names in groups(face):
        if heading:
            lines.append(_heading(heading.replace("``", ""), "-"))
        for name in names:
            lines += _entry(face, public_names()[f"{face}.{name}"], name)
    return "\n".join(lines)


def _heading(text: str, line: str) -> str:
    return f"{text}\n{line * len(text)}\n"


def _entry(face: str, name: Name, shown: str) -> list[str]:
    """The lines of a name: its documentation, or a link to it where another package has it."""
    if (name.face, name.name) != (face, shown):
        return [f"``{shown}`` is documented as :py:obj:`{name.path}`.", ""]
    if name.kind == "autodata":
        text = comment_of(name).replace("`", "``").replace("````", "``")
        kind = type(name.value)
        shown = [f"   :type: {kind.__name__}"] if kind.__module__ == "builtins" else []
        return [f".. py:data:: {name.path}", *shown, "", f"   {text}", ""]
    lines = [f".. {name.kind}:: {name.path}"]
    if name.kind == "autoclass":
        lines += ["   :members:", f"   :inherited-members: {_ends(name.value)}"]
        if isinstance(name.value, type) and issubclass(name.value, Enum):
            lines.append("   :undoc-members:")
    if name.kind == "autoexception":
        lines += ["   :show-inheritance:"]
    return [*lines, ""]


def _ends(value: object) -> str:
    """The classes whose members are not listed again: those of other packages."""
    assert isinstance(value, type)
    foreign = [base for base in value.__mro__ if not base.__module__.startswith("equimesh")]
    return ", ".join(base.__name__ for base in foreign) or "object"
