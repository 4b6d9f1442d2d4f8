"""The public names of the Python packages: in which package each is documented, and under which heading."""

from __future__ import annotations

import ast
import importlib
import inspect
from dataclasses import dataclass
from functools import cache
from pathlib import Path

# The packages whose names are public, and the page of each. The first one that has an object documents it.
FACES = (
    "equimesh",
    "equimesh.io",
    "equimesh.plot",
    "equimesh.quality",
    "equimesh.schwarz",
    "equimesh.meshes",
    "equimesh.upload",
    "equimesh.specs",
    "equimesh_cluster",
    "equimesh.testing",
    "equimesh_client",
    "equimesh_coupling",
    "equimesh_schema",
    "equimesh_service",
)


@dataclass(frozen=True, kw_only=True)
class Name:
    """A public name: the package that documents it, and the object."""

    face: str
    name: str
    value: object

    @property
    def path(self) -> str:
        """The dotted name by which it is imported."""
        return f"{self.face}.{self.name}"

    @property
    def kind(self) -> str:
        """The directive of autodoc that documents it."""
        if inspect.isclass(self.value):
            return "autoexception" if issubclass(self.value, BaseException) else "autoclass"
        return "autofunction" if inspect.isroutine(self.value) else "autodata"


def groups(face: str) -> list[tuple[str, list[str]]]:
    """The headings and names of ``__all__`` of a package, in its order; one heading is empty where it has none."""
    module = importlib.import_module(face)
    path = Path(str(module.__file__))
    source = path.read_text(encoding="utf-8")
    (assigned,) = (
        node.value
        for node in ast.parse(source).body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id == "__all__"
    )
    found: list[tuple[str, list[str]]] = [("", [])]
    for line in source.splitlines()[assigned.lineno : assigned.end_lineno]:
        word = line.strip()
        if word.startswith("#"):
            found.append((word.removeprefix("#").strip(), []))
        elif word.startswith('"'):
            found[-1][1].append(word.strip('",'))
    names = list(ast.literal_eval(assigned))
    added = [name for name in module.__all__ if name not in names]  # the list of another module
    if [name for _, group in found for name in group] != names:
        found = [("", names)]  # __all__ is written on one line
    found[-1][1].extend(added)
    return [(heading, group) for heading, group in found if group]


@cache
def public_names() -> dict[str, Name]:
    """Each public name by its dotted path; an object of several packages is the same ``Name`` in all of them."""
    found: dict[str, Name] = {}
    documented: dict[int, Name] = {}
    for face in FACES:
        module = importlib.import_module(face)
        for name in module.__all__:
            value = getattr(module, name)
            new = Name(face=face, name=name, value=value)
            is_shared = inspect.isclass(value) or inspect.isroutine(value)
            found[new.path] = documented.setdefault(id(value), new) if is_shared else new
    return found


@cache
def public_path(dotted: str) -> str | None:
    """The dotted path under which an object is documented; None for one that is not public.

    ``dotted`` may name the object in the module of its definition, or a member of it.
    """
    if dotted in public_names():
        return public_names()[dotted].path
    for name in public_names().values():
        defined = f"{getattr(name.value, '__module__', '')}.{getattr(name.value, '__qualname__', '')}"
        if dotted == defined or dotted.startswith(f"{defined}."):
            return name.path + dotted.removeprefix(defined)
    owner, _, member = dotted.rpartition(".")
    if owner and (path := public_path(owner)) is not None:
        return f"{path}.{member}"
    return None


def path_of_last(name: str) -> str | None:
    """The dotted path of a name without its package, where one package alone has it."""
    found = {known.path for known in public_names().values() if known.name == name}
    return found.pop() if len(found) == 1 else None


def comment_of(name: Name) -> str:
    """The comment above a constant, or the text below it, in the module that defines it."""
    package = Path(str(importlib.import_module(name.face).__file__))
    for node in ast.parse(package.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and any(alias.name == name.name for alias in node.names):
            return _comment(Path(str(importlib.import_module(str(node.module)).__file__)), name.name)
    return ""


def _comment(path: Path, name: str) -> str:
    lines = path.read_text(encoding="utf-8").splitlines()
    body = ast.parse("\n".join(lines)).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        if not (isinstance(target, ast.Name) and target.id == name):
            continue
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            return inspect.cleandoc(str(after.value.value))
        first = node.lineno - 1
        while lines[first - 1].startswith("#"):
            first -= 1
        return " ".join(line.lstrip("# ") for line in lines[first : node.lineno - 1])
    return ""
