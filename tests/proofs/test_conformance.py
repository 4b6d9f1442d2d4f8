"""The client and the real service: one test uses every name of both twins, the others one of the two."""

from __future__ import annotations

import contextlib
import inspect
import io
import json
import math
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from client.conftest import Blocking
from equimesh_cli.command import build_parser, main
from equimesh_client import (
    AnnulusSector,
    AsyncClient,
    AsyncMesh,
    AsyncSequence,
    BadArgument,
    Certificate,
    Client,
    Conflict,
    DeadlineExceeded,
    Estimate,
    Forbidden,
    Mesh,
    MeshCanceled,
    MissingLibrary,
    NotFound,
    Quadrilateral,
    QuotaExceeded,
    RetryPolicy,
    Schwarz,
    Sequence,
    Tensor,
    Unauthorized,
)
from equimesh_client.client import AsyncMeshes, AsyncSamplesStore, Meshes, SamplesStore
from equimesh_client.sequence import AsyncSequences, Sequences

equimesh_service = pytest.importorskip("equimesh_service")
PAPER = "(1-exp(15*(x-1)))*sin(pi*y)"


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A service with one worker."""
    folder = tmp_path_factory.mktemp("service")
    settings = equimesh_service.Settings(
        port=0, data_dir=folder, workers=1, log_level="warning", max_points=40_000, max_body=2**20
    )
    with equimesh_service.running(settings) as address:
        yield address


@pytest.fixture
def client(connect: Any, url: str) -> Any:
    return connect(url, timeout=300.0)


# One of the twins, which share all of their code, shows what they do.
BLOCKING, ASYNCHRONOUS = (pytest.mark.parametrize("connect", [twin], indirect=True) for twin in ("sync", "async"))


def heavy(**more: Any) -> dict[str, Any]:
    """A spec that keeps a worker busy for a while."""
    schwarz = Schwarz(subdomains=(4, 4), overlap=2, tolerance=None, max_iterations=1000).to_json()
    monitor = {"kind": "arc_length", "u": {"expression": "tanh(20*((x-0.5)**2+(y-0.5)**2-0.09))"}}
    return {"monitor": monitor, "grid": {"n_xi": 200, "n_eta": 200}, "schwarz": schwarz, **more}


def test_the_command_line_hands_the_settings_to_the_solver() -> None:
    import equimesh as em
    from equimesh_cli.options.problem import build

    words = "--transmission optimized --interface-data local --ordering symmetric --line-correction 0 --tolerance none"
    asked = build(build_parser("solve").parse_args(["solve", "x", "--subdomains", "4x2", *words.split()]))
    assert asked.schwarz == em.Schwarz(
        subdomains=(4, 2),
        transmission=em.Optimized(data="local"),
        ordering="symmetric",
        line_correction=0,
        tolerance=None,
    )


@BLOCKING
def test_notebooks_show_meshes_and_sequences(client: Any) -> None:
    figure = pytest.importorskip("matplotlib.figure")
    mesh = client.generate("tanh(9*(x-y))", 9)
    axes = figure.Figure().subplots()
    assert mesh.plot(axes) is axes
    colours = axes.collections[0].get_array()
    assert colours.size == 64
    assert colours.max() > 2 * colours.min() > 0.0
    told = mesh._repr_html_()
    assert mesh.certificate.headline in told
    assert told.count("data:image/png;base64,") == 1
    assert "data:image" in mesh.arrays()._repr_html_()
    sequence = client.sequences.start("tanh(9*(x-y))", 9)
    page = sequence._repr_html_()
    assert sequence.current.mesh_id in page
    assert sequence.current.plot(axes) is axes
    assert "81" in page or "9 x 9" in page
    sequence.delete()


def test_a_notebook_shows_the_numbers_of_a_mesh_whose_client_is_closed(url: str) -> None:
    with Client(url) as client:
        mesh = client.generate("tanh(9*(x-y))", 9)
    told = mesh._repr_html_()
    assert mesh.certificate.headline in told
    assert "<img" not in told


@ASYNCHRONOUS
def test_files_in_every_format(client: Any, tmp_path: Path) -> None:
    meshio = pytest.importorskip("meshio")
    mesh = client.generate("x*y", 9, cells="triangle", a=0.7)
    for name in ("m.vtu", "m.vtk", "m.msh", "m.npz", "m.xdmf.zip", "n.xdmf"):
        assert mesh.download(tmp_path / name).stat().st_size > 0
    for name in ("m.vtu", "m.vtk", "m.msh", "n.xdmf", "n_facets.xdmf"):
        read = meshio.read(tmp_path / name)
        assert len(read.points) == 81, name
    assert len(meshio.read(tmp_path / "n.xdmf").cells_dict["triangle"]) == 128
    assert not [path.name for path in tmp_path.iterdir() if path.suffix == ".part"]
    mesh.download(tmp_path / "quads.vtu", cells="quad")
    assert len(meshio.read(tmp_path / "quads.vtu").cells_dict["quad"]) == 64
    assert mesh.cells.shape == (128, 3)
    assert mesh.arrays().q_eq.shape == (8, 8)
    here = mesh.to_meshio()
    assert here.cell_sets["left"][1].size == 8
    file = meshio.read(tmp_path / "m.vtu")
    for name in ("Q_eq", "subdomain"):
        assert np.allclose(here.cell_data[name][0], file.cell_data[name][0]), name
    assert set(here.point_data) == set(file.point_data) == {"u", "xi", "eta"}
    assert all(np.allclose(here.point_data[name], file.point_data[name]) for name in file.point_data)


FRONT = "tanh(3*(x - y))"
BEND = Quadrilateral(
    bottom=("1+t", "0"),
    right=("2*cos(q*t)", "2*sin(q*t)", {"q": np.pi / 2}),
    top=[[0, 1], [0, 2]],
    left=("cos(q*t)", "sin(q*t)", {"q": np.pi / 2}),
)


@BLOCKING
def test_arrays_and_callables_lie_on_the_box_of_the_domain(client: Any) -> None:
    exact = client.generate(FRONT, 12, domain=BEND, a=0.7)
    x, y = np.meshgrid(np.linspace(0, 2, 97), np.linspace(0, 2, 97), indexing="ij")
    for u in (lambda x, y: np.tanh(3 * (x - y)), np.tanh(3 * (x - y))):
        mesh = client.generate(u, 12, domain=BEND, a=0.7)
        assert abs(mesh.x - exact.x).max() < 1e-3
    stored = client.samples.upload(np.tanh(3 * (x - y)), domain=BEND)
    assert abs(client.generate(stored, 12, domain=AnnulusSector(), a=0.7).x - exact.x).max() < 1e-3
    big = np.tanh(3 * (x - y))
    both = client.generate(monitor=Tensor(2 + big, "0", 2 - big), n=12, domain=BEND)
    assert both.u is None
    assert both.certificate.interpolation_gain is None
    assert client.check("log(x*x+y*y)", domain=BEND)["domain"]["area"] == pytest.approx(0.75 * np.pi)


@ASYNCHRONOUS
def test_a_deadline_cancels(client: Any) -> None:
    spec = heavy()
    with pytest.raises(DeadlineExceeded):
        client.generate(spec["monitor"]["u"]["expression"], 200, schwarz=spec["schwarz"], label="late", deadline=1.0)
    (mesh,) = client.meshes.list(label="late", limit=1)
    with pytest.raises(MeshCanceled):
        mesh.wait(deadline=300)


@pytest.fixture(scope="module")
def keyed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, dict[str, str]]]:
    """A service with keys: its address, and the secrets of ``ada``, ``ben`` and ``reader``."""
    folder, secrets = tmp_path_factory.mktemp("keyed"), {}
    for name, scope in (("ada", "write"), ("ben", "write"), ("reader", "read")):
        with contextlib.redirect_stdout(io.StringIO()) as said:
            assert main(["keys", "create", "--name", name, "--scope", scope, "--data-dir", str(folder), "--json"]) == 0
        secrets[name] = json.loads(said.getvalue())["secret"]
    settings = equimesh_service.Settings(
        port=0, data_dir=folder, workers=1, log_level="warning", max_points=40_000, key_max_queued=1
    )
    with equimesh_service.running(settings) as address:
        yield address, secrets


@BLOCKING
def test_keys(
    connect: Any, keyed: tuple[str, dict[str, str]], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    url, secrets = keyed
    caplog.set_level("DEBUG")
    impatient = RetryPolicy(retries=0)
    said = []
    for key in ("", "em_nobody_000", secrets["ada"][:-1] + "!"):
        with pytest.raises(Unauthorized, match="EQUIMESH_KEY") as unknown:
            connect(url, key=key).meshes.get("m")
        said.append(str(unknown.value))
    with pytest.raises(Forbidden, match="write") as forbidden:
        connect(url, key=secrets["reader"]).generate("x", 8, a=0.7)
    monkeypatch.setenv("EQUIMESH_KEY", secrets["ada"])
    ada, ben = connect(url, retries=impatient), connect(url, key=secrets["ben"])
    mesh = ada.meshes.create(heavy())
    with pytest.raises(NotFound):
        ben.meshes.get(mesh.id)
    with pytest.raises(QuotaExceeded) as full:
        ada.generate("x", 8, a=0.7)
    assert full.value.retry_after is not None
    mesh.cancel()
    mesh.delete()
    assert list(ada.meshes.list()) == []
    assert ada.url == url
    said += [str(forbidden.value), repr(forbidden.value), str(full.value), repr(ada), repr(mesh), caplog.text]
    for secret in secrets.values():
        assert not any(secret in words for words in said)


class CuttingProxy:
    """Passes connections on to a service, and cuts some of them after so many bytes of the answer."""

    def __init__(self, target: str) -> None:
        self.cuts: list[int] = []
        host, port = target.removeprefix("http://").split(":")
        self.target = (host, int(port))
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self.listener.getsockname()[1]}"
        self.open: list[socket.socket] = []
        self.passed = 0  # bytes of answers
        self.threads = [threading.Thread(target=self.accept)]
        self.threads[0].start()

    def cut(self, *limits: int) -> None:
        """Hang up now, and cut the next connections."""
        self.cuts = list(limits)
        self.hang_up()

    def hang_up(self) -> None:
        for end in self.open:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def accept(self) -> None:
        while True:
            try:
                near, _ = self.listener.accept()
            except OSError:
                return
            far = socket.create_connection(self.target)
            self.open += [near, far]
            limit = self.cuts.pop(0) if self.cuts else None
            for source, sink, most in ((near, far, None), (far, near, limit)):
                self.threads.append(threading.Thread(target=self.pump, args=(source, sink, near, most)))
                self.threads[-1].start()

    def pump(self, source: socket.socket, sink: socket.socket, near: socket.socket, limit: int | None) -> None:
        passed = 0
        with contextlib.suppress(OSError):
            while passed != limit and (data := source.recv(4096)):
                data = data if limit is None else data[: limit - passed]
                sink.sendall(data)
                passed += len(data)
                self.passed += len(data) if sink is near else 0
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self.listener.shutdown(socket.SHUT_RDWR)
        self.listener.close()
        self.hang_up()
        for thread in self.threads:
            thread.join(timeout=10)
        for end in self.open:
            end.close()


@pytest.fixture
def proxy(url: str) -> Iterator[CuttingProxy]:
    """A line to the service that breaks."""
    made = CuttingProxy(url)
    yield made
    made.close()


@ASYNCHRONOUS
def test_every_event_comes_once_over_a_line_that_breaks(
    connect: Any, client: Any, proxy: CuttingProxy, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("equimesh_service.api.events._RETRY_MILLISECONDS", 1)
    mesh = client.meshes.create(heavy(grid={"n_xi": 64, "n_eta": 64}))
    far = connect(proxy.url, retries=RetryPolicy(retries=99, first=0.001, longest=0.01)).meshes.get(mesh.id)
    proxy.cut(*(int(cut) for cut in np.random.default_rng(4).integers(1, 900, 500)))
    told = []
    for event in far.events(deadline=300):
        told.append(event)
        if len(told) == 10:
            mesh.cancel()
    assert [event.id for event in told] == list(range(1, len(told) + 1))
    assert [(e.id, e.kind, e.data) for e in mesh.events()] == [(e.id, e.kind, e.data) for e in told]
    assert told[-1].kind == "done"
    assert len(told) >= 10
    assert len(proxy.cuts) <= 490  # it did break, at beginnings and in the middle of events


@ASYNCHRONOUS
def test_a_file_over_a_line_that_breaks(connect: Any, client: Any, proxy: CuttingProxy, tmp_path: Path) -> None:
    mesh = client.generate(PAPER, 129, a=0.7)
    whole = mesh.download(tmp_path / "near.vtu").read_bytes()
    far = connect(proxy.url, retries=RetryPolicy(retries=1, first=0.001)).meshes.get(mesh.id)
    proxy.cut(*(int(cut) for cut in np.random.default_rng(5).integers(2000, 20_000, 9)))
    # ten connections and one retry: each goes on where the one before ended
    assert far.download(tmp_path / "far.vtu").read_bytes() == whole
    assert proxy.cuts == []
    assert proxy.passed < len(whole) + 10 * 4000


TWINS = [
    (Client, AsyncClient),
    (Meshes, AsyncMeshes),
    (SamplesStore, AsyncSamplesStore),
    (Mesh, AsyncMesh),
    (Sequence, AsyncSequence),
    (Sequences, AsyncSequences),
]


ONE_BLOCK = {
    "vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]},
    "blocks": [{"corners": ["a", "b", "c", "d"], "cells": [4, 4]}],
}


def public(kind: type) -> dict[str, Any]:
    return {name: inspect.getattr_static(kind, name) for name in dir(kind) if not name.startswith("_")}


@pytest.mark.parametrize("pair", TWINS, ids=lambda pair: pair[0].__name__)
def test_both_clients_have_the_same_names(pair: tuple[type, type]) -> None:
    # what is a property of one mesh is a method of the other, or in its arrays
    only = {"points", "cells", "boundary", "sides", "blocks", "x", "y", "u"} if pair[0] is Mesh else set()
    blocking, awaited = map(public, pair)
    assert set(blocking) - only == set(awaited)


def record_names(monkeypatch: pytest.MonkeyPatch) -> set[tuple[str, str]]:
    """The public names of the twins that tests use from now on, as pairs of class and name; grows while they do."""
    used: set[tuple[str, str]] = set()

    def record(target: object, name: str) -> Any:
        if not name.startswith("_") and not sys._getframe(1).f_globals["__name__"].startswith("equimesh_client"):
            used.add((type(target).__name__, name))
        return object.__getattribute__(target, name)

    for kind in (kind for pair in TWINS for kind in pair):
        monkeypatch.setattr(kind, "__getattribute__", record)
    return used


def test_every_public_name_of_the_twins_works(
    connect: Any, url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    used = record_names(monkeypatch)
    client = connect(url)
    assert client.url == url
    assert client.check("x")["constant"] is False
    assert client.capabilities()["version"]

    mesh = client.generate(PAPER, (9, 7), label="tour", reuse=False, a=0.7)
    assert (mesh.status, mesh.is_finished, mesh.label) == ("succeeded", True, "tour")
    assert (mesh.error, mesh.reused_from, mesh.id, mesh.record["label"]) == (None, None, mesh.record["id"], "tour")
    assert (mesh.relaxed, mesh.warnings, mesh.certificate.status, mesh.attempts) == (False, (), "converged", 1)
    assert (mesh.progress.fraction, mesh.timings["solve"] > 0) == (1.0, True)
    assert {len(mesh.points), mesh.x.size, mesh.y.size, mesh.u.size, mesh.arrays().u.size} == {63}
    assert (len(mesh.cells), len(mesh.boundary), len(mesh.sides)) == (48, 4, 4)
    assert not getattr(mesh, "blocks", ())  # the twin has them in its arrays
    assert len(mesh.mesh_parts("triangle").cells) == 96
    assert mesh.quality.q_eq.max == np.nanmax(mesh.quality_of_cells().q_eq.cells)
    assert (mesh.convergence.iterations, mesh.spec()["label"]) == ((), "tour")
    assert mesh.download(tmp_path / "m.npz").exists()
    assert mesh.plot().format == "svg"
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(BadArgument, match="pip install meshio"):
        mesh.to_meshio()
    for library in (
        "skfem",
        "dolfinx",
        "pyvista",
        "fipy",
        "mfem.ser",
        "ngsolve",
        "sfepy.discrete.fem",
        "petsc4py.PETSc",
    ):
        monkeypatch.setitem(sys.modules, library, None)
    for hand_over in (mesh.to_skfem, mesh.to_pyvista, mesh.to_fipy, mesh.to_mfem, mesh.to_ngsolve, mesh.to_sfepy):
        with pytest.raises(MissingLibrary, match="which is not installed: pip install"):
            hand_over()
    for hand_over in (mesh.to_dolfinx, mesh.to_dmplex):
        with pytest.raises(MissingLibrary, match="which is not installed: apt-get install"):
            hand_over(None)
    assert mesh.refresh().wait().id == mesh.id
    for call in (mesh.parts, lambda: mesh.part(0), lambda: mesh.download_parts(tmp_path)):
        with pytest.raises(NotFound, match="This mesh is whole, and has no parts"):
            call()
    assert [event.kind for event in mesh.events()][-1] == "done"
    with pytest.raises(Conflict):
        mesh.cancel()

    assert client.meshes.get(mesh.id).record == next(client.meshes.list(label="tour")).record
    client.meshes.create(mesh.spec()).delete()
    stored = client.samples.upload(np.ones((2, 2)))
    client.samples.get(stored.id)
    client.samples.delete(stored)
    (tmp_path / "one.json").write_text(json.dumps(ONE_BLOCK))
    client.samples.delete(client.samples.upload_mesh(tmp_path / "one.json"))

    sequence = client.sequences.start("x*y", 9)
    assert sequence.step("x*y", t=0.5).number == sequence.current.number == 1
    assert sequence.x.shape == sequence.y.shape == (9, 9)
    assert sequence.mesh().status == "succeeded"
    assert sequence.id in {record.id for record in client.sequences.list(limit=5)}
    client.sequences.get(sequence.id).delete()
    assert client.compute("x*y", 9).x.shape == (9, 9)
    assert client.compute_file(tmp_path / "kept_here.vtu", "x*y", 9) is not None
    assert client.adapt(lambda mesh: mesh.x * mesh.y**2, 9, rounds=1).values.shape == (9, 9)
    client.close()

    kinds = [
        kind for pair in TWINS for kind in pair if kind.__name__.startswith("Async") is isinstance(client, Blocking)
    ]
    in_arrays = {("AsyncMesh", name) for name in ("points", "cells", "boundary", "sides", "x", "y", "u")}
    assert {(kind.__name__, name) for kind in kinds for name in public(kind)} - in_arrays <= used


def test_a_taken_port_is_a_sentence_and_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    handler = signal.getsignal(signal.SIGTERM)  # `serve` sets its own
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        for words, code in (
            (["serve", "--data-dir", str(tmp_path / "data")], 2),
            (["demo", "--output", str(tmp_path)], 3),
        ):
            assert main([*words, "--port", port]) == code
            said = capsys.readouterr().err
            assert "in use" in said
            assert said.startswith("equimesh: ")
            assert list(tmp_path.iterdir()) == []
    signal.signal(signal.SIGTERM, handler)


def test_a_certificate_reads_the_same_after_its_way_through_json() -> None:
    em = pytest.importorskip("equimesh")
    errors = pytest.importorskip("equimesh.quality.interpolation").InterpolationErrors
    status = pytest.importorskip("equimesh.solving.status").Status
    asked = [("a", 0.7, 0.35), ("points", 129.0, 33.0), ("cross_line", 0.0, 0.03), ("strength", 1.0, 0.123)]
    relaxed = tuple(em.Relaxed(what=what, asked=least, reached=most) for what, least, most in asked)
    gain = errors(l2=1e-3, h1=1e-2, l2_uniform=5.432e-3, h1_uniform=2.0, rounding=(0.0, 0.0))
    compared = (
        em.Candidate(kind="least_error", settings={"distortion": 0.5}, gain_l2=12.3, gain_h1=3.0, chosen=True),
        em.Candidate(kind="curvature", settings={}, gain_l2=math.nan, gain_h1=math.nan, chosen=False),
    )
    aim = em.Aim(norm="h1", error=0.1, grid=(33, 17), predicted=0.098, reached=0.097, solves=2)
    faces = pytest.importorskip("equimesh.quality.faces").Faces(
        non_orthogonality=12.3, mean_non_orthogonality=4.5, skewness=0.67
    )
    bare = {"status": status.CONVERGED, "mode": None, "equation_residual": 0.0, "min_jacobian": 1.0, "faces": faces}
    estimate = Estimate(l2=1.2e-3, h1=0.3, unresolved=0.1, moved_cells=2.5)
    for certificate in (
        em.Certificate(**bare),
        em.Certificate(**bare, algebraic_error=0.0, discretization_error=1.2345e-4, interpolation=gain),
        em.Certificate(**{**bare, "equation_residual": 1e-3}, relaxed=relaxed, warnings=("Beware.",)),
        em.Certificate(**{**bare, "equation_residual": math.inf}),
        em.Certificate(**{**bare, "equation_residual": None}, comparison=compared, target=aim),
        em.Certificate(**{**bare, "equation_residual": None}, estimate=estimate),
        em.Certificate(**bare, understood={"monitor.u": "2*x"}, interpolation=replace(gain, l2=6e-3)),
        em.Certificate(**bare, interpolation=replace(gain, l2=5.2e-3, l2_uniform=5.4e-3), compared_with="initial"),
        em.Certificate(**bare, interpolation=replace(gain, l2=0.0)),
        em.Certificate(**{**bare, "status": status.NEWTON_FAILED}),
        em.Certificate(**{**bare, "equation_residual": None}, comparison=compared),
    ):
        assert str(certificate) == str(Certificate.from_json(certificate.summary()))
    assert "equation residual" not in str(certificate)
    assert "least error (distortion 0.5): 12 in L2, 3 in H1  (chosen)" in str(certificate)
    assert "curvature: no valid mesh" in str(certificate)
    certificate = em.Certificate(**{**bare, "equation_residual": 1e-3}, relaxed=relaxed, warnings=("Beware.",))
    assert "warning: Beware." in str(certificate)
    assert "estimated error       not known\n" in str(certificate)
    for words in (
        "129 requested, 33 reached",
        "cross-line term of weight 0.03 added\n",
        "monitor: 1 requested, 0.12 reached",
    ):
        assert words in str(certificate)
    typed = str(em.Certificate(**bare, understood={"monitor.u": "2*x"}))
    assert "  read as               monitor.u = 2*x\n" in typed
    known = str(em.Certificate(**bare, algebraic_error=0.0, discretization_error=1.2345e-4, interpolation=gain))
    assert "0.00012 of the grid, exact of the solution on it" in known
    assert "5.4 in L2, 200 in H1" in known
