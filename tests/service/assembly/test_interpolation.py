"""How often samples are interpolated on their way through the service, counted in all its processes."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from service.conftest import small, until
from service.processes import service_process

COUNTING = """\
import os

import equimesh.fields.nodal_field as nodal
import equimesh.fields.samples as samples


def counted(function):
    def wrapped(*arguments):
        with open({count!r}, "a") as file:
            file.write(f"{{os.getpid()}}\\n")
        return function(*arguments)

    return wrapped


samples.bicubic_spline = counted(samples.bicubic_spline)
nodal.through = counted(nodal.through)
"""
AXIS = np.linspace(0.0, 1.0, 9)
X, Y = np.meshgrid(AXIS, AXIS, indexing="ij")
POINTS = np.random.default_rng(3).random((200, 2))
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
SCATTERED = np.concatenate([POINTS, CORNERS])
UPLOAD = {"kind": "arc_length", "u": {"samples": "upload"}}


def npz(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


GRID = npz(x=AXIS, y=AXIS, values=np.tanh(9 * (X - Y)))
FILES = {
    "grid": ("u.npz", GRID),
    "scattered": ("u.npz", npz(points=SCATTERED, values=np.tanh(9 * (SCATTERED[:, 0] - 0.5)))),
    "nodal": ("u.npz", npz(x=X + 0.02 * np.sin(np.pi * X) * Y, y=Y, values=np.tanh(9 * (X - 0.5)))),
    "csv": ("u.csv", "\n".join(["x,y,u", *(f"{x},{y},{x * x + y}" for x in AXIS for y in AXIS)]).encode()),
}


@pytest.fixture(scope="module")
def counted(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[httpx.Client, Path]]:
    """A service, and the file in which each interpolation is a line."""
    folder = tmp_path_factory.mktemp("counted")
    count = folder / "count"
    with service_process(folder, workers=1, first=COUNTING.format(count=str(count)), REUSE="false") as service:
        service.start()
        service.ready()
        with httpx.Client(base_url=service.url, timeout=120.0) as http:
            yield http, count
        service.stop()


def interpolations(counted: tuple[httpx.Client, Path], monitor: Any, file: Any = None, **headers: str) -> list[str]:
    """The processes that interpolated, once for each time, for a mesh with this monitor."""
    http, count = counted
    count.write_text("")
    spec = json.dumps(small(monitor=monitor))
    body: dict[str, Any] = {"content": spec} if file is None else {"files": {"spec": (None, spec), "samples": file}}
    given = {"Content-Type": "application/json"} if file is None else {}
    answer = http.post("/v1/meshes", **body, headers={**given, **headers})
    assert answer.status_code in (201, 202), answer.text
    place = f"/v1/meshes/{answer.json()['id']}"
    assert until(lambda: http.get(place).json()["status"] in ("succeeded", "failed"))
    assert http.get(place).json()["status"] == "succeeded"
    return count.read_text().split()


@pytest.mark.parametrize("wait", [{}, {"Prefer": "wait=60"}], ids=["queue", "at once"])
@pytest.mark.parametrize("kind", FILES)
def test_uploaded_samples_are_interpolated_once(
    counted: tuple[httpx.Client, Path], kind: str, wait: dict[str, str]
) -> None:
    assert len(interpolations(counted, UPLOAD, FILES[kind], **wait)) == 1


@pytest.mark.parametrize("kind", FILES)
def test_stored_samples_are_interpolated_once_for_a_mesh(counted: tuple[httpx.Client, Path], kind: str) -> None:
    http, count = counted
    count.write_text("")
    stored = http.post("/v1/samples", files={"samples": FILES[kind]})
    assert stored.is_success, stored.text
    assert count.read_text() == ""
    monitor = {"kind": "arc_length", "u": {"samples": stored.json()["id"]}}
    assert len(interpolations(counted, monitor)) == 1
    assert len(interpolations(counted, monitor)) == 1  # the monitor is known to be valid


def test_samples_in_a_long_spec_and_named_twice_are_interpolated_once(counted: tuple[httpx.Client, Path]) -> None:
    x = np.linspace(0.0, 1.0, 150)
    values = np.tanh(9 * np.subtract.outer(x, x))
    grid = {"x": x.tolist(), "y": x.tolist(), "values": values.tolist()}
    assert len(json.dumps(grid)) > 256 * 1024
    assert len(interpolations(counted, {"kind": "arc_length", "u": {"grid": grid}})) == 1
    both = {"kind": "intersection", "monitors": [UPLOAD, {"kind": "weight", "rho": "1", "u": {"samples": "upload"}}]}
    assert len(interpolations(counted, both, FILES["grid"])) == 1
