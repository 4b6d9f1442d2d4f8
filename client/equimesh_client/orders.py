"""A request for a mesh, made ready: what `generate` and `meshes.create` of both clients share."""

from __future__ import annotations

import importlib
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from equimesh_client.errors import BadArgument, MeshCanceled, MeshFailed
from equimesh_client.records import MeshArrays, MeshState
from equimesh_client.sources import Source, StoredSamples, source_of, upload_of
from equimesh_client.spec import Schwarz, mesh_spec

DEADLINE = 600.0
"""Seconds that a wait may take when the caller does not say."""


@dataclass(frozen=True, kw_only=True)
class Order:
    """One logical request for a mesh. ``key`` stays the same over all retries, so that one mesh comes of
    it.
    """

    spec: dict[str, Any]
    source: Source | None
    key: str


def order(
    u: object,
    n: int | tuple[int, int],
    *,
    a: float,
    b: float,
    schwarz: Schwarz | Mapping[str, Any] | None,
    boundary: str,
    initial: str,
    cells: str,
    label: str | None,
    parameters: Mapping[str, float] | None,
    t: float | None,
    n_samples: int,
) -> Order:
    """The request for the mesh that `generate` is asked for."""
    source = source_of(u, parameters=parameters, t=t, n_samples=n_samples)
    spec = mesh_spec(
        source.json,
        n,
        a=a,
        b=b,
        schwarz=schwarz,
        boundary=boundary,
        initial=initial,
        cells=cells,
        label=label,
    )
    return Order(spec=spec, source=source, key=str(uuid.uuid4()))


def order_of_spec(spec: Mapping[str, Any], samples: object, key: str | None) -> Order:
    """The request for a complete spec; ``samples`` goes with ``"u": {"samples": "upload"}``.

    Raises :class:`BadArgument` when one of the two is missing.
    """
    if not isinstance(spec, Mapping):
        raise BadArgument(f"a spec is a mapping, as in the HTTP interface, not {type(spec).__name__}")
    monitor = spec.get("monitor")
    u = monitor.get("u") if isinstance(monitor, Mapping) else None
    wanted = isinstance(u, Mapping) and u.get("samples") == "upload"
    if wanted != (samples is not None):
        raise BadArgument('samples go with a spec whose monitor has "u": {"samples": "upload"}, and only with it')
    source = Source(json={}, upload=upload_of(samples)) if samples is not None else None
    return Order(spec=dict(spec), source=source, key=key or str(uuid.uuid4()))


def settled(mesh: MeshState) -> None:
    """Nothing for a mesh that succeeded; raises :class:`MeshFailed` or :class:`MeshCanceled` for one that
    did not.
    """
    if mesh.status == "failed":
        raise MeshFailed(mesh, mesh.error or {})
    if mesh.status == "canceled":
        raise MeshCanceled(mesh)


def stored(record: Mapping[str, Any]) -> StoredSamples:
    """Samples that the service keeps."""
    return StoredSamples(id=str(record["id"]), record=dict(record))


def meshio_mesh(arrays: MeshArrays) -> Any:
    """A ``meshio.Mesh`` of the cells and named boundary lines, with the data that the files have.

    Raises :class:`BadArgument` when meshio is not installed.
    """
    try:
        # By name: the client does not depend on meshio, and import-linter holds it to that.
        meshio = importlib.import_module("meshio")
    except ImportError as error:
        raise BadArgument("to_meshio() needs meshio, which is not installed: pip install meshio") from error
    sides = list(arrays.boundary.items())
    empty = np.zeros(0, dtype=np.int64)
    kind, parts = ("triangle", 2) if arrays.cells.shape[1] == 3 else ("quad", 1)
    along_xi, along_eta = (np.linspace(0.0, 1.0, n) for n in arrays.x.shape)
    xi, eta = np.meshgrid(along_xi, along_eta, indexing="ij")
    of_cells = {"Q_eq": (arrays.q_eq, np.nan), "subdomain": (arrays.subdomain, -1)}  # and what a side has in its place
    return meshio.Mesh(
        arrays.points,
        [(kind, arrays.cells), *(("line", edges) for _, edges in sides)],
        point_data={"u": arrays.u.ravel(), "xi": xi.ravel(), "eta": eta.ravel()},
        cell_data={
            name: [np.repeat(values.ravel(), parts), *(np.full(len(edges), none) for _, edges in sides)]
            for name, (values, none) in of_cells.items()
        },
        cell_sets={
            name: [np.arange(len(edges)) if block == place else empty for block in range(len(sides) + 1)]
            for place, (name, edges) in enumerate(sides, start=1)
        },
    )
