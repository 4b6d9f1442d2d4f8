"""preCICE in the threads of one process: what two serial solvers call, with the rules of preCICE 3.2.

``Participant`` has the methods of ``precice.Participant`` (pyprecice 3.2 and later) with their arguments and results,
and reads the same configuration file. It knows one kind of coupling: two participants, ``parallel-explicit``, one step
a time window, and mappings ``linear-cell-interpolation`` in the direction ``read``, in two dimensions. It raises
:class:`Error` where preCICE does:

- a mesh or data that the configuration does not give to the participant;
- vertices that are set at another time than before ``initialize`` or after ``reset_mesh``;
- ``reset_mesh`` that the configuration does not allow, or that does not follow a complete time window;
- data that are read from a mesh that has just been reset, data of unknown vertices, data of another count.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from matplotlib.tri import LinearTriInterpolator, Triangulation

SECONDS = 120.0


class Error(RuntimeError):
    """A call that preCICE refuses."""


@dataclass
class _Run:
    """What two participants share."""

    root: ElementTree.Element
    step: float
    end: float
    meeting: threading.Barrier = field(default_factory=lambda: threading.Barrier(2))
    meshes: dict[str, tuple[Any, Any]] = field(default_factory=dict)
    data: dict[tuple[str, str], Any] = field(default_factory=dict)


_runs: dict[str, _Run] = {}
_lock = threading.Lock()


def _run(path: str) -> _Run:
    with _lock:
        if path not in _runs:
            # ElementTree knows no prefixes without a namespace: preCICE's own are no XML namespaces either.
            root = ElementTree.fromstring(Path(path).read_text().replace("mapping:", "mapping-").replace(":", "-"))
            scheme = root.find("coupling-scheme-parallel-explicit")
            assert scheme is not None, "a coupling that this module does not know"
            times = [float(scheme.find(name).get("value")) for name in ("time-window-size", "max-time")]  # type: ignore[union-attr, arg-type]
            _runs[path] = _Run(root, *times)
        return _runs[path]


class Participant:
    """One of the two participants of a configuration."""

    def __init__(self, solver_name: str, configuration_file_name: str, index: int, size: int) -> None:
        if (index, size) != (0, 1):
            raise Error("serial participants only")
        self._path, self._run = configuration_file_name, _run(configuration_file_name)
        own = self._run.root.find(f"participant[@name='{solver_name}']")
        if own is None:
            raise Error(f"the configuration has no participant {solver_name}")
        self._own = own
        self._state, self._time, self._complete = "constructed", 0.0, False
        self._open = {each.get("name") for each in own.iter("provide-mesh")}
        self._reset: set[str] = set()
        self._read: dict[tuple[str, str], Any] = {}

    def get_mesh_dimensions(self, mesh_name: str) -> int:
        return int(self._run.root.find(f"mesh[@name='{mesh_name}']").get("dimensions"))  # type: ignore[union-attr, arg-type]

    def get_data_dimensions(self, mesh_name: str, data_name: str) -> int:
        self._used("use-data", data_name, self._run.root.find(f"mesh[@name='{mesh_name}']"))
        return 1 if self._run.root.find(f"data-scalar[@name='{data_name}']") is not None else 2

    def requires_mesh_connectivity_for(self, mesh_name: str) -> bool:
        found = self._run.root.iter("mapping-linear-cell-interpolation")
        return any(each.get("from") == mesh_name for each in found)

    def set_mesh_vertices(self, mesh_name: str, positions: Any) -> Any:
        self._require_open(mesh_name)
        points = np.asarray(positions, dtype=np.float64)
        if points.shape[1] != self.get_mesh_dimensions(mesh_name):
            raise Error("positions of another dimension")
        self._run.meshes[mesh_name] = (points, None)
        return np.arange(len(points), dtype=np.int32)

    def set_mesh_triangles(self, mesh_name: str, vertices: Any) -> None:
        self._require_open(mesh_name)
        self._run.meshes[mesh_name] = (self._run.meshes[mesh_name][0], np.asarray(vertices))

    def reset_mesh(self, mesh_name: str) -> None:
        allowed = [self._run.root.get(name) for name in ("experimental", "allow-remeshing")]
        if allowed != ["true", "true"]:
            raise Error("remeshing is not allowed by the configuration")
        if self._state != "initialized" or not self._complete or not self.is_coupling_ongoing():
            raise Error("reset_mesh outside of the first step after a complete time window")
        self._open.add(mesh_name)
        self._reset.add(mesh_name)

    def initialize(self) -> None:
        self._state, self._open = "initialized", set()
        self._exchange()

    def write_data(self, mesh_name: str, data_name: str, vertex_ids: Any, values: Any) -> None:
        self._check_data("write-data", mesh_name, data_name, vertex_ids)
        found = np.asarray(values, dtype=np.float64)
        if found.size != len(vertex_ids) * self.get_data_dimensions(mesh_name, data_name):
            raise Error("inconsistent sizes")
        self._run.data[mesh_name, data_name] = found.reshape(len(vertex_ids), -1)[np.argsort(vertex_ids)]

    def read_data(self, mesh_name: str, data_name: str, vertex_ids: Any, relative_read_time: float) -> Any:
        self._check_data("read-data", mesh_name, data_name, vertex_ids)
        if mesh_name in self._reset:
            raise Error("cannot read from a mesh after it has been reset")
        if not 0.0 <= relative_read_time <= self.get_max_time_step_size() + 1e-12:
            raise Error("data outside of the time window")
        found = self._read[mesh_name, data_name][vertex_ids]
        return found[:, 0] if found.shape[1] == 1 else found

    def is_coupling_ongoing(self) -> bool:
        return self._time < self._run.end - 1e-12

    def is_time_window_complete(self) -> bool:
        return self._complete

    def get_max_time_step_size(self) -> float:
        return self._run.step if self.is_coupling_ongoing() else 0.0

    def advance(self, computed_timestep_length: float) -> None:
        if not self.is_coupling_ongoing() or abs(computed_timestep_length - self._run.step) > 1e-12:
            raise Error("a step that is no whole time window")
        self._time += computed_timestep_length
        self._complete, self._open, self._reset = True, set(), set()
        self._exchange()

    def finalize(self) -> None:
        self._state = "finalized"
        with _lock:
            _runs.pop(self._path, None)

    def _require_open(self, mesh: str) -> None:
        self._used("provide-mesh", mesh, self._own)
        if mesh not in self._open:
            raise Error(f"the mesh {mesh} cannot be changed now")

    def _check_data(self, tag: str, mesh: str, data: str, vertices: Any) -> None:
        if self._state != "initialized":
            raise Error("data before initialize() or after finalize()")
        if not any((each.get("name"), each.get("mesh")) == (data, mesh) for each in self._own.iter(tag)):
            raise Error(f"the configuration has no {tag} {data} on {mesh}")
        if sorted(vertices) != list(range(len(self._run.meshes[mesh][0]))):
            raise Error("unknown vertices")

    @staticmethod
    def _used(tag: str, name: str, parent: Any) -> None:
        if parent is None or not any(each.get("name") == name for each in parent.iter(tag)):
            raise Error(f"the configuration has no {tag} {name} here")

    def _exchange(self) -> None:
        """Meet the other participant, and map what it has written to the own mesh."""
        self._run.meeting.wait(SECONDS)
        for mapping in self._own.iter("mapping-linear-cell-interpolation"):
            source, target = str(mapping.get("from")), str(mapping.get("to"))
            for each in self._own.iter("read-data"):
                name = str(each.get("name"))
                self._read[target, name] = self._mapped(source, target, name)
        self._run.meeting.wait(SECONDS)

    def _mapped(self, source: str, target: str, name: str) -> Any:
        (points, cells), (places, _) = self._run.meshes[source], self._run.meshes[target]
        values = self._run.data.get((source, name))
        if values is None:  # nothing was written as initial data
            return np.zeros((len(places), self.get_data_dimensions(target, name)))
        cut = Triangulation(*points.T, triangles=cells)
        inside = np.clip(places, points.min(axis=0) + 1e-9, points.max(axis=0) - 1e-9)
        return np.stack([LinearTriInterpolator(cut, column)(*inside.T).filled() for column in values.T], axis=-1)
