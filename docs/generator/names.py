"""A Sphinx extension that links Python names in docstrings and signatures to the places where they are documented."""

from __future__ import annotations

import re
import sys
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

from generator.faces import path_of_last, public_path

# Packages of others, whose documentation is not here: their names stay without a link.
_FOREIGN = {
    *("builtins", "collections", "concurrent", "contextlib", "dataclasses", "datetime", "enum", "os", "pathlib"),
    *("threading", "types", "typing"),
    *("distributed", "httpx", "matplotlib", "numpy", "pydantic_settings", "scipy", "skfem"),
}
# Arrays of NumPy in signatures, and the names that the code has for them.
_ARRAY = re.compile(
    r"~?(?:numpy\.)?ndarray\[tuple\[~?(?:typing\.)?Any, \.\.\.\], ~?(?:numpy\.)?dtype\[~?(?:numpy\.|typing\.)?(\w+)\]\]"
)
_ALIASES = {"float64": "Array", "int64": "IntArray", "bool": "BoolArray", "bool_": "BoolArray", "Any": "AnyArray"}

_NAME = re.compile(r"[\w.\[\] ]+")
# Names of others that signatures have without their module, or in parts of a text.
_SHORT = frozenset({*_ALIASES.values(), "Axes", "Figure", "Path", "ArrayLike", "Series", "int", "str"})


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the search for names that Sphinx does not find."""
    app.connect("missing-reference", _resolve)
    app.connect("autodoc-process-signature", _shorten)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _shorten(*event: Any) -> tuple[str | None, str | None]:
    """The signature and the type of the result, with the names of this project for types of arrays."""
    found = [text and _ARRAY.sub(lambda match: _ALIASES[match[1]], text) for text in event[-2:]]
    return found[0], found[1]


def _resolve(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.TextElement
) -> nodes.reference | nodes.TextElement | None:
    """A link to the public name; the text alone for one that is not public; None, which warns, for no name at all."""
    if node.get("refdomain") != "py":
        return None
    target = str(node["reftarget"]).removeprefix("tuple[").removeprefix("~")  # of a tuple of any length
    if not _NAME.fullmatch(target):
        return content  # a part of what marks an annotated type: OneOf('expression', 'grid')
    inside = f"{node.get('py:module')}.{target}"
    path = public_path(target) or public_path(inside) or path_of_last(target)
    if path is not None:
        domain = env.domains.python_domain
        for kind in ("obj", "attr", "meth"):
            found = domain.resolve_xref(env, node["refdoc"], app.builder, kind, path, node, content)
            if found is not None:
                return found
    known = target.split(".")[0] in _FOREIGN or target in _SHORT or _exists(target) or path is not None
    return content if known else None


def _exists(dotted: str) -> bool:
    """Whether a dotted name is a module of ours, or leads to a member of one; its package may be left out."""
    ours = [module for name, module in [*sys.modules.items()] if name.split(".")[0].startswith("equimesh")]
    if dotted.startswith("equimesh"):
        dotted, ours = dotted.partition(".")[2], [import_module(dotted.split(".")[0])]
    return any(_has(module, dotted.split(".")) for module in ours)


def _has(found: object, parts: list[str]) -> bool:
    """Whether the parts of a name lead from an object to a member; a field of a class counts."""
    for k, part in enumerate(parts):
        if isinstance(found, ModuleType) and hasattr(found, "__path__") and not hasattr(found, part):
            name = f"{found.__name__}.{part}"
            if find_spec(name) is not None:
                import_module(name)
        if not hasattr(found, part):
            fields = getattr(found, "__annotations__", {}) if isinstance(found, type) else {}
            return k == len(parts) - 1 and part in fields
        found = getattr(found, part)
    return True
