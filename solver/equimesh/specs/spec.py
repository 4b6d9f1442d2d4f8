"""A whole document: the JSON form of a problem, which the service, the command line and problem files share."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias, Unpack

from equimesh.blocks.blocks import Blocks
from equimesh.blocks.counts import plan_of
from equimesh.blocks.description import Description
from equimesh.blocks.fixed_rectangle import between_fixed_lines, fixed_rectangle
from equimesh.domains.curve import Curve
from equimesh.domains.domain import UNIT_SQUARE, AnnulusSector, Domain, Rectangle
from equimesh.domains.quadrilateral import Quadrilateral
from equimesh.equations.problem import SLIDING_NODES, Boundary, Problem, in_blocks
from equimesh.errors import InputError
from equimesh.inputs import choice
from equimesh.io.write import CELLS, Cells
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.monitors.least_error import LeastError, NodalSolution
from equimesh.monitors.monitor import require_lines
from equimesh.schwarz.conditions import Classical, LinearRobin, NonlinearRobin, Optimized
from equimesh.schwarz.decomposition import Decomposition
from equimesh.schwarz.settings import Schwarz
from equimesh.single_domain.level import Mode
from equimesh.solving.solution import AnySolution
from equimesh.solving.solve import NO_DEGREE, NO_ROUNDS, NO_STRAIGHT_LINES, Round, count_subdomains, solve
from equimesh.solving.status import Initial, SolveArguments
from equimesh.solving.target import NO_GRID, NO_U, Target, require_target_of_a_round, solve_to
from equimesh.specs.document import Makers, Reading, mapping, several, text, whole, within
from equimesh.specs.monitors import FindSamples, build_monitor, counted, no_samples, samples_in
from equimesh_schema import domains as domains_schema
from equimesh_schema import mesh as mesh_schema
from equimesh_schema import schwarz as schwarz_schema
from equimesh_schema.domains import DOMAINS
from equimesh_schema.mesh import MeshSpec
from equimesh_schema.monitors import MONITORS

# Physical domains and grids of a document.

FindMesh: TypeAlias = Callable[[str, Mapping[str, Any]], Blocks]
"""The blocks of the mesh file with a name, by the ``corners`` and the ``corner_angle`` of a document."""


def build_domain(document: object, find_mesh: FindMesh | None = None, path: str = "domain") -> Domain | Blocks:
    """The domain that ``document`` describes, a rectangle where it has no ``kind``.

    ``find_mesh(name, settings)`` returns the blocks of the mesh file of a domain of kind ``mesh``.

    Raises :class:`~equimesh.errors.InputError`, whose field begins with ``path``.
    """
    found: Domain | Blocks = Reading(domain_makers(find_mesh or no_meshes)).one_of(
        domains_schema.DOMAINS, document, path
    )
    return found


def count_points(document: Mapping[str, Any]) -> int:
    """The number of nodes of the mesh that a description of blocks gives, which is not made.

    Raises :class:`~equimesh.errors.InputError`, whose field begins with ``domain``.
    """
    given = {name: value for name, value in document.items() if name != "kind"}
    is_rectangle = document.get("kind") == domains_schema.FixedRectangle.kind
    return plan_of(Description.of(fixed_rectangle(**given) if is_rectangle else document)).layout.node_count


def domain_makers(find_mesh: FindMesh, folder: Path | None = None) -> Makers:
    """What makes domains and their curves: ``find_mesh`` finds mesh files, files of points lie in ``folder``."""

    def blocks(**given: Any) -> Blocks:
        return Blocks.of({name: value for name, value in given.items() if value is not None}, folder)

    def fixed(**given: Any) -> Blocks:
        with between_fixed_lines():
            return Blocks.of(fixed_rectangle(**given, folder=folder))

    def mesh(file: object, corners: object = (), corner_angle: float | None = None) -> Blocks:
        kept = several(lambda corner, _: corner, corners, "corners")
        settings = {"corners": kept or None, "corner_angle": corner_angle}
        return find_mesh(text(file, "file"), {name: value for name, value in settings.items() if value is not None})

    return {
        domains_schema.Rectangle: Rectangle,
        domains_schema.AnnulusSector: AnnulusSector,
        domains_schema.Quadrilateral: Quadrilateral,
        domains_schema.FormulaCurve: Curve.of_expressions,
        domains_schema.PointCurve: Curve.through,
        domains_schema.Blocks: blocks,
        domains_schema.FixedRectangle: fixed,
        domains_schema.MeshFile: mesh,
    }


def meshes_in(folder: Path) -> FindMesh:
    """Mesh files whose names are those of files in ``folder``, as :meth:`~equimesh.Blocks.read` reads them.

    What it returns raises :class:`~equimesh.errors.InputError` for a file that cannot be read.
    """

    def find(name: str, settings: Mapping[str, Any]) -> Blocks:
        try:
            return Blocks.read(folder / name, **settings)
        except OSError as error:
            raise InputError(f"{folder / name}: {error.strerror or error}", field="file") from error

    return find


def no_meshes(name: str, settings: Mapping[str, Any]) -> Blocks:  # noqa: ARG001 - a FindMesh
    """Raises :class:`~equimesh.errors.InputError`: there are no files with names."""
    raise InputError(f"there is no mesh file named {name[:40]!r} here: give find_mesh", field="file")


# Grids, targets and settings of the Schwarz iteration in a document.

ON_BLOCKS = tuple(kind for kind, made in DOMAINS.documents.items() if made.HAS_BLOCKS)
"""The kinds of domains that have blocks."""
NO_TARGET = "the subdomains of a Schwarz iteration are parts of a grid that is known: give n_xi and n_eta"


def usual_grid(**given: int) -> Grid:
    """The grid of the numbers of points that are given, and the usual ones in place of others."""
    made = mesh_schema.Grid(**given)
    return Grid(n_xi=made.n_xi, n_eta=made.n_eta)


MAKERS: Makers = {
    mesh_schema.Grid: usual_grid,
    mesh_schema.Target: Target,
    schwarz_schema.Schwarz: Schwarz,
    schwarz_schema.Optimized: Optimized,
    schwarz_schema.Classical: Classical,
    schwarz_schema.LinearRobin: LinearRobin,
    schwarz_schema.NonlinearRobin: NonlinearRobin,
}
READING = Reading(MAKERS)


def block_schwarz(given: object) -> Schwarz | None:
    """The settings of the iteration between the blocks of a domain, where those of a grid stand; None where null."""
    if given is None:
        return None
    found: Schwarz = READING.record(schwarz_schema.Schwarz, given, "schwarz")
    found.require_blocks()
    return found


def build_schwarz(document: object) -> Schwarz | None:
    """The Schwarz settings of a whole ``document``, which fit its grid; None for a single domain, and on blocks.

    Those of blocks are read, and need the domain to be compared with. Of the monitor it reads no function.

    Raises :class:`~equimesh.errors.InputError`, whose field begins with ``grid`` or ``schwarz``, also for a monitor
    that subdomains cannot solve.
    """
    given = mapping(document, "")
    domain = given.get("domain")
    settings = given.get("schwarz")
    if isinstance(domain, Mapping) and domain.get("kind") in ON_BLOCKS:
        block_schwarz(settings)
        return None
    if settings is None:
        return None
    schwarz: Schwarz = READING.record(schwarz_schema.Schwarz, settings, "schwarz")
    is_descent = is_least_error(given)
    if is_descent and given["monitor"].get("rectilinear"):
        raise InputError(NO_STRAIGHT_LINES, field="monitor.rectilinear")
    if given.get("target") is not None:
        raise InputError(NO_TARGET, field="target")
    grid = READING.record(mesh_schema.Grid, {} if given.get("grid") is None else given["grid"], "grid")
    if is_descent:
        schwarz.require_descent()
        schwarz.owner_of_cells(grid)
        return schwarz
    schwarz.require_equations()
    if isinstance(given.get("monitor"), Mapping) and given["monitor"].get("degree", 1) != 1:
        raise InputError(NO_DEGREE, field="monitor.degree")
    with within("schwarz"):
        schwarz.decompose(grid)
    return schwarz


def is_least_error(document: Mapping[str, Any]) -> bool:
    """Whether the monitor of a document asks for least error, whose subdomains descend."""
    monitor = document.get("monitor")
    return isinstance(monitor, Mapping) and monitor.get("kind") == "least_error"


def subdomains_of(document: Mapping[str, Any]) -> Decomposition | None:
    """The rectangles of the Schwarz iteration on the grid of a valid document; None for a single domain, on blocks."""
    schwarz, grid = build_schwarz(document), document.get("grid")
    if schwarz is None:
        return None
    made = READING.record(mesh_schema.Grid, {} if grid is None else grid, "grid")
    return schwarz.rectangles(made) if is_least_error(document) else schwarz.decompose(made)


AUTOMATIC_PARTS: Final = "auto"
NOT_WITH_BLOCKS: Final[Mapping[str, str]] = {
    "grid": "the blocks of the domain have numbers of cells of their own: give points alone, which chooses them, or"
    " leave the grid out",
    "boundary": SLIDING_NODES,
    "parts": "a mesh of blocks is computed on one machine: leave parts out, or solve in Python with "
    "equimesh_cluster.solve_blocks",
}
"""The sentences for what goes with a grid alone, by the keys of a document."""
NumberOfParts: TypeAlias = int | Literal["auto"] | None
"""How many parts of a cluster a mesh is solved in; ``"auto"``: as many as fit its workers, None: not in parts."""


@dataclass(frozen=True, kw_only=True)
class BuiltSpec:
    """The contents of a document: the arguments of :func:`equimesh.solve`, and the ``cells`` of the file.

    ``schwarz`` is None for a single domain, and that between blocks for these. ``target`` is None where the document
    has a grid; otherwise it goes to :func:`equimesh.solve_to`, and ``problem`` has the first grid. ``label`` is free
    text of the sender. ``parts`` is the number of parts on a cluster, ``"auto"`` or None; the points do not depend on
    it.
    """

    problem: Problem[Any]
    schwarz: Schwarz | None
    target: Target | None
    initial: Initial
    mode: Mode
    allow_relaxed: bool
    cells: Cells
    label: str | None
    parts: NumberOfParts = None

    @property
    def grid_problem(self) -> Problem:
        """The problem, which has a grid.

        Raises :class:`~equimesh.errors.InputError` for one on blocks, with the field ``domain``.
        """
        if in_blocks(self.problem):
            raise InputError("this needs a domain with four sides, whose meshes have a grid", field="domain")
        return self.problem

    @property
    def grid_schwarz(self) -> Schwarz | None:
        """The Schwarz iteration that equidistributes on a grid; None for a single domain, and for least error."""
        is_descent = in_blocks(self.problem) or isinstance(self.problem.monitor, LeastError)
        return None if is_descent else self.schwarz

    @property
    def ending(self) -> SolveArguments:
        """The options that only equidistribution has: when a solve ends, and what it accepts. None on blocks."""
        return {} if in_blocks(self.problem) else {"mode": self.mode, "allow_relaxed": self.allow_relaxed}

    def solve(
        self,
        *,
        start: Mesh | None = None,
        began: Callable[[Grid], None] | None = None,
        **options: Unpack[SolveArguments],
    ) -> AnySolution:
        """The solution on the grid, on blocks, or for the target; raises what these two functions raise.

        ``options`` are added to those of the document. ``start`` is a mesh of the reference square in place of
        ``initial``. ``began`` is called with every grid of a target before it is solved.
        """
        settings: SolveArguments = {"initial": self.initial, **self.ending, **options}
        if start is not None:
            settings["initial"] = start
        problem = self.problem
        if self.target is None:
            return solve(problem, self.schwarz, **settings)
        return solve_to(
            self.target,
            monitor=problem.monitor,
            domain=problem.domain,
            boundary=problem.boundary,
            began=began,
            **settings,
        )


def build(
    document: Mapping[str, Any],
    find_samples: FindSamples = no_samples,
    find_mesh: FindMesh = no_meshes,
    folder: Path | None = None,
) -> BuiltSpec:
    """The problem that ``document`` describes, a mapping in the JSON form of the HTTP interface.

    Only ``monitor`` is required; every default is the solver's. ``find_samples(name, box)`` returns the field of a
    source ``{"samples": name}``; its samples must cover ``box = ((x0, x1), (y0, y1))``, that of the domain.
    ``find_mesh(name, settings)`` returns the blocks of a domain ``{"kind": "mesh", "file": name}``. Files of points of
    the curves of blocks lie in ``folder``.

    Raises :class:`~equimesh.errors.InputError` for values that cannot be used, wrong types and unknown keys; ``field``
    is the path of the fault in the document, e.g. ``"monitor.u.expression"`` or ``"schwarz.overlap"``.
    """
    fault = mesh_schema.fault_of_points(mapping(document, ""))
    if fault is not None:
        raise InputError(fault[1], field=fault[0])
    if (aimed := mesh_schema.with_target(document)) is not document:
        try:
            return build(aimed, find_samples, find_mesh, folder)
        except InputError as error:
            error.field = "grid.points" if error.field.partition(".")[0] == "target" else error.field
            raise
    makers: Makers = {**MAKERS, **domain_makers(find_mesh, folder), MeshSpec: dict}
    given = Reading(makers, {MONITORS: _as_given}).record(MeshSpec, document)
    parts = _parts(given)
    if isinstance(parts.domain, Blocks):
        return _on_blocks(parts, parts.domain, given.get("schwarz"), find_samples)
    if parts.target is not None and parts.grid is not None:
        raise InputError("a target takes the place of the grid: give one of them", field="target")
    schwarz = build_schwarz(document)
    monitor = build_monitor(given["monitor"], parts.domain, find_samples, cells=parts.options["cells"])
    if schwarz is not None:
        require_lines(monitor)
    if parts.target is not None and monitor.u is None:
        raise InputError(NO_U, field="target")
    if parts.target is not None:
        with within("target"):
            parts.target.require_possible(parts.domain)
    grid = parts.grid or (usual_grid() if parts.target is None else parts.target.grid(parts.domain))
    if isinstance(monitor, NodalSolution):
        if schwarz is not None:
            raise InputError(NO_ROUNDS, field="schwarz")
        if parts.target is None:
            monitor.require_grid(grid)
        else:
            require_target_of_a_round(parts.target, monitor)
            grid = monitor.mesh_on(parts.domain).grid
    problem = Problem(monitor=monitor, grid=grid, boundary=parts.boundary, domain=parts.domain)
    return _built(parts, problem, schwarz)


def _on_blocks(parts: _Parts, blocks: Blocks, schwarz: Schwarz | None, find_samples: FindSamples) -> BuiltSpec:
    """The contents of a document whose domain has blocks."""
    given = {
        "grid": parts.grid is not None,
        "boundary": parts.boundary is not Boundary.TRACE,
        "parts": parts.options["parts"] is not None,
    }
    for name, is_given in given.items():
        if is_given:
            raise InputError(NOT_WITH_BLOCKS[name], field=name)
    blocks = counted(blocks, parts.monitor, find_samples)
    monitor: Any = build_monitor(parts.monitor, blocks, find_samples, cells=parts.options["cells"])
    problem = Problem(monitor=monitor, domain=blocks)
    if schwarz is not None:
        count_subdomains(problem, schwarz)
    if parts.target is not None:
        _check_budget(parts.target, problem, schwarz)
    return _built(parts, problem, schwarz)


def _built(parts: _Parts, problem: Problem[Any], schwarz: Schwarz | None) -> BuiltSpec:
    """The contents of a document with these parts; refuses the start of a round."""
    if isinstance(problem.monitor, NodalSolution):
        Round().require(problem, parts.options["initial"])
    return BuiltSpec(problem=problem, schwarz=schwarz, target=parts.target, **parts.options)


def _check_budget(target: Target, problem: Problem[Any], schwarz: Schwarz | None) -> None:
    """Refuse a target that cannot choose the counts of blocks."""
    if target.error is not None:
        raise InputError(NO_GRID, field="target.error")
    if schwarz is not None:
        message = "subdomains are groups of blocks whose cells are known: give no number of points, and no target"
        raise InputError(message, field="target")
    if isinstance(problem.monitor, NodalSolution):
        require_target_of_a_round(target, problem.monitor)
    with within("target"):
        target.require_possible(problem.domain)


def load(path: str | os.PathLike[str]) -> BuiltSpec:
    """The problem in a JSON file, as :func:`build`; names of samples are those of files in the same folder.

    Raises :class:`~equimesh.errors.InputError`, also for a file that is not JSON, and :class:`OSError` for one that
    cannot be read.
    """
    file = Path(path)
    try:
        document = json.loads(file.read_bytes())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file.name} is not JSON: {error}") from error
    return build(document, samples_in(file.parent), meshes_in(file.parent), file.parent)


@dataclass(frozen=True, kw_only=True)
class _Parts:
    """The parts of a document, whose monitor needs the domain and is not built yet. ``options`` are of a BuiltSpec."""

    monitor: object
    domain: Domain | Blocks
    grid: Grid | None
    target: Target | None
    boundary: Boundary
    options: Mapping[str, Any]


def _parts(given: Mapping[str, Any]) -> _Parts:
    """The parts of what is ``given``, with the usual values of the schema in place of others."""
    spec = MeshSpec(**given)
    return _Parts(
        monitor=spec.monitor,
        domain=given.get("domain", UNIT_SQUARE),
        grid=given.get("grid"),
        target=given.get("target"),
        boundary=choice(Boundary, spec.boundary, "boundary"),
        options={
            "initial": choice(Initial, spec.initial, "initial"),
            "mode": choice(Mode, spec.mode, "mode"),
            "allow_relaxed": spec.allow_relaxed,
            "cells": _cells(spec.cells, "cells"),
            "label": None if spec.label is None else text(spec.label, "label"),
            "parts": _number_of_parts(spec.parts, "parts"),
        },
    )


def _as_given(value: object, path: str) -> object:  # noqa: ARG001 - a reader
    return value


def _cells(value: object, path: str) -> Cells:
    for known in CELLS:
        if value == known:
            return known
    raise InputError(f"{path} = {value!r}: choose one of {', '.join(CELLS)}", field=path)


def _number_of_parts(value: object, path: str) -> NumberOfParts:
    if value is None or value == AUTOMATIC_PARTS:
        return value
    number = whole(value, path)
    if number < 1:
        raise InputError(f"{path} = {number}: at least one part is needed", field=path)
    return number
