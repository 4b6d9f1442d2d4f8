"""A small service over real sockets, with faults on order: it drops connections, lies and answers late."""

from __future__ import annotations

import hashlib
import io
import json
import re
import socket
import threading
import time
import zipfile
from dataclasses import dataclass, field
from email.parser import BytesParser
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np

from equimesh_client.wire.downloads import FOAM_FILES

CERTIFICATE: dict[str, Any] = {
    "status": "relaxed",
    "mode": "discretization",
    "equation_residual": 2.5e-5,
    "discretization_error": 1e-3,
    "algebraic_error": 1e-4,
    "min_jacobian": 0.25,
    "non_orthogonality": {"max": 41.7, "mean": 16.9},
    "skewness": 0.62,
    "relaxed": [{"what": "a", "asked": 0.7, "reached": 0.35}],
    "warnings": ["The mesh adapts less than requested."],
    "interpolation_gain": {"l2": 5.4, "h1": 2.4},
}
AIM = {"norm": "l2", "error": 0.0, "grid": [9, 7], "predicted": 1e-3, "reached": 1e-3, "solves": 2}
SIDES = ("left", "right", "bottom", "top")


@dataclass
class Fault:
    """What goes wrong with the next request that matches, ``times`` times."""

    pattern: str
    # drop: no answer; lose: done, but no answer; status; half: body cut; cut: after some bytes; damage: wrong bytes;
    # longer, shorter: a wrong length; elsewhere: a 206 of other bytes than requested
    action: str = "drop"
    status: int = 503
    headers: dict[str, str] = field(default_factory=dict)
    body: dict[str, Any] | None = None
    times: int = 1
    cut: int = 0


@dataclass
class Request:
    method: str
    path: str
    query: dict[str, str]
    headers: dict[str, str]
    body: bytes


def mesh_file(n_xi: int, n_eta: int) -> bytes:
    x, y = np.meshgrid(np.linspace(0, 1, n_xi), np.linspace(0, 1, n_eta), indexing="ij")
    number = np.arange(n_xi * n_eta).reshape(n_xi, n_eta)
    corners = (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    lines = {"left": number[0, ::-1], "right": number[-1], "bottom": number[:, 0], "top": number[::-1, -1]}
    file = io.BytesIO()
    np.savez(
        file,
        x=x,
        y=y,
        u=x + y,
        cells=np.stack([c.ravel() for c in corners], axis=1),
        q_eq=np.ones((n_xi - 1, n_eta - 1)),
        subdomain=np.zeros((n_xi - 1, n_eta - 1), dtype=int),
        **{side: np.column_stack([lines[side][:-1], lines[side][1:]]) for side in SIDES},
    )
    return file.getvalue()


def foam_archive() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as zipped:
        for name in FOAM_FILES:
            zipped.writestr(name, name)
    return file.getvalue()


def archive() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as zipped:
        for part in ("mesh", "facets"):
            zipped.writestr(f"{part}.xdmf", f"<DataItem>{part}.h5:/data0</DataItem>")
            zipped.writestr(f"{part}.h5", part)
    return file.getvalue()


class FakeService:
    """State and faults. A mesh labelled ``slow`` takes three looks, ``hang`` never ends, ``fail`` fails."""

    def __init__(self) -> None:
        self.requests: list[Request] = []
        self.faults: list[Fault] = []
        self.meshes: dict[str, dict[str, Any]] = {}
        self.looks: dict[str, int] = {}
        self.keys: dict[str, str] = {}
        self.parted: list[tuple[str, bytes]] = []  # the files of a mesh in parts, the head last
        self.samples: dict[str, bytes] = {}
        self.events = [
            ("status", {"status": "running"}),
            ("progress", {"fraction": 0.25}),
            ("progress", {"fraction": 0.5}),
        ]
        self.events += [("progress", {"fraction": 0.75, "word": "größer"}), ("done", {"status": "succeeded"})]
        self.cuts: list[int] = []  # the k-th event stream is cut after this number of bytes
        self.file: bytes | None = None  # the file of every mesh, in place of its own
        self.ranges = True  # whether Range is heeded
        self.etags = '"{}"'  # how an ETag is written
        self.lock = threading.Lock()
        handler = type("Handler", (_Handler,), {"service": self})
        self.server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        self.server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self.server.server_port}"
        self.thread = threading.Thread(target=self.server.serve_forever, kwargs={"poll_interval": 0.02})
        self.thread.start()

    def close(self) -> None:
        self.server.shutdown()
        self.server.server_close()
        self.thread.join()

    def seen(self, method: str, pattern: str) -> list[Request]:
        return [r for r in self.requests if r.method == method and re.search(pattern, r.path)]

    def fault(self, method: str, path: str) -> Fault | None:
        for fault in self.faults:
            if fault.times > 0 and re.search(fault.pattern, f"{method} {path}"):
                fault.times -= 1
                return fault
        return None


class _Handler(BaseHTTPRequestHandler):
    service: FakeService
    protocol_version = "HTTP/1.1"

    def log_message(self, *args: object) -> None:
        pass

    def do_GET(self) -> None:
        self._serve()

    do_POST = do_DELETE = do_GET

    def _serve(self) -> None:
        parts = urlsplit(self.path)
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        query = {key: values[0] for key, values in parse_qs(parts.query).items()}
        headers = {key.lower(): value for key, value in self.headers.items()}
        request = Request(self.command, parts.path, query, headers, body)
        with self.service.lock:
            self.service.requests.append(request)
            fault = self.service.fault(self.command, parts.path)
        if fault is not None and fault.action == "drop":
            self._hang_up()
        elif fault is not None and fault.action == "status":
            self._json(fault.status, fault.body or {"title": "Service unavailable"}, fault.headers)
        elif parts.path.endswith("/events"):
            self._events(request)
        else:
            with self.service.lock:
                status, headers, data = self._answer(request)
            if fault is not None and fault.action == "lose":
                self._hang_up()
            elif fault is not None and fault.action == "half":
                self._send(status, headers, data, cut=len(data) // 2)
            elif fault is not None and fault.action == "cut":
                self._send(status, headers, data, cut=fault.cut)
            elif fault is not None and fault.action in ("longer", "shorter"):
                lie = len(data) + (10 if fault.action == "longer" else -10)
                self._send(status, {**headers, "Content-Length": str(lie)}, data, cut=min(lie, len(data)))
            elif fault is not None and fault.action == "elsewhere":
                self._send(206, {**headers, "Content-Range": f"bytes 1-{len(data) - 1}/{len(data)}"}, data[1:])
            elif fault is not None and fault.action == "damage":
                self._send(status, headers, bytes([data[0] ^ 1]) + data[1:])
            elif fault is not None and fault.action == "late":
                time.sleep(1.0)
                self._hang_up()
            else:
                self._send(status, headers, data)

    def _hang_up(self) -> None:
        self.close_connection = True
        self.connection.shutdown(socket.SHUT_RDWR)

    def _json(self, status: int, value: Any, headers: dict[str, str] | None = None) -> None:
        self._send(status, {"Content-Type": "application/json", **(headers or {})}, json.dumps(value).encode())

    def _send(self, status: int, headers: dict[str, str], data: bytes, cut: int | None = None) -> None:
        try:
            self.send_response(status)
            for name, value in headers.items():
                self.send_header(name, value)
            if status != 204 and "Content-Length" not in headers:
                self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data if cut is None else data[:cut])
            if cut is not None:
                self.wfile.flush()
                self._hang_up()
        except OSError:
            self.close_connection = True

    def _events(self, request: Request) -> None:
        after = int(request.headers.get("last-event-id", "0"))
        if after == len(self.service.events):
            self._send(204, {}, b"")
            return
        text = ": hello\n\n"
        for number, (kind, data) in enumerate(self.service.events, start=1):
            if number > after - 1:  # one event too many on purpose: the client drops what it has
                text += f"id: {number}\nevent: {kind}\ndata: {json.dumps(data, ensure_ascii=False)}\n\n"
        data = text.encode()
        cut = self.service.cuts.pop(0) if self.service.cuts else None
        self.close_connection = True
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream; charset=utf-8")
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        data = data if cut is None else data[:cut]
        for start in range(0, len(data), 7):
            piece = data[start : start + 7]
            self.wfile.write(f"{len(piece):x}\r\n".encode() + piece + b"\r\n")
        if cut is None:
            self.wfile.write(b"0\r\n\r\n")

    def _answer(self, request: Request) -> tuple[int, dict[str, str], bytes]:
        found = re.fullmatch(r"/v1/meshes(?:/([^/]+))?(?:/([\w/]+))?", request.path)
        if request.path == "/v1/capabilities":
            return _json(200, {"formats": ["vtu", "npz"]})
        if request.path == "/v1/expressions/check":
            return self._check(json.loads(request.body))
        if request.path == "/v1/samples":
            data = parts_of(request)["samples"][1]
            name = hashlib.sha256(data).hexdigest()[:12]
            self.service.samples[name] = data
            return _json(201, {"id": name, "shape": [3, 3]})
        if request.path.startswith("/v1/samples/"):
            if self.service.samples.pop(request.path.rsplit("/", 1)[1], None) is None:
                return _problem(404, "Not found")
            return 204, {}, b""
        if found is None:
            return _problem(404, "Not found")
        mesh_id, part = found.groups()
        if mesh_id is None:
            return self._create(request) if request.method == "POST" else self._list(request)
        if mesh_id not in self.service.meshes:
            return _problem(404, "Not found")
        if request.method == "DELETE":
            del self.service.meshes[mesh_id]
            return 204, {}, b""
        return self._part(request, mesh_id, part)

    def _part(self, request: Request, mesh_id: str, part: str | None) -> tuple[int, dict[str, str], bytes]:
        mesh = self.service.meshes[mesh_id]
        if part is None:
            self._look(mesh)
            return _json(200, _public(mesh))
        if part == "cancel":
            if mesh["status"] in ("succeeded", "failed", "canceled"):
                return _problem(409, "Conflict")
            mesh["status"] = "canceled"
            return _json(200, _public(mesh))
        if part.startswith("parts"):
            return self._file_of_parts(request, part.removeprefix("parts").strip("/"))
        if part == "file" and request.query["format"] == "pvtu":
            return self._range(request, self.service.parted[-1][1])
        if part == "file":
            grid = mesh["spec"]["grid"]
            data = self.service.file or mesh_file(grid["n_xi"], grid["n_eta"])
            if request.query["format"] == "xdmf":
                data = archive()
            elif request.query["format"] == "foam":
                data = foam_archive()
            return self._range(request, data)
        if part == "quality":
            return _json(200, {"q_eq": {"max": 1.5, "min": 0.5, "mean": 1.0, "rms": 1.1}, "min_jacobian": 0.25})
        if part == "convergence":
            rows = [{"iteration": k, "max_q_eq": 2.0 - k, "change": None, "subdomains": []} for k in range(2)]
            return _json(200, {"iterations": rows, "rate": 0.5, "predicted_rate": None})
        if part == "spec":
            return _json(200, mesh["spec"])
        if part == "plot":
            kind = request.query["format"]
            return 200, {"Content-Type": request.headers["accept"]}, b"<svg/>" if kind == "svg" else b"\x89PNG"
        return _problem(404, "Not found")

    def _file_of_parts(self, request: Request, number: str) -> tuple[int, dict[str, str], bytes]:
        files = self.service.parted
        if number:
            return self._range(request, files[int(number)][1])
        listed = [
            {"name": name, "media_type": "x/y", "size": len(data), "sha256": hashlib.sha256(data).hexdigest()}
            for name, data in files
        ]
        parts = [
            {"number": k, "first": 2 * k, "last": 2 * k + 2, "rows": 3, "file": file}
            for k, file in enumerate(listed[:-1])
        ]
        more = {
            "format": request.query["format"],
            "formats": ["pvtu", "npz"],
            "grid": {"n_xi": 5, "n_eta": 4},
            "id": "m",
            "count": 2,
        }
        head = None if request.query["format"] == "npz" else listed[-1]
        return _json(200, {**more, "size": None, "head": head, "parts": parts})

    def _range(self, request: Request, data: bytes) -> tuple[int, dict[str, str], bytes]:
        etag = self.service.etags.format(hashlib.sha256(data).hexdigest())
        headers = {"Content-Type": "x/y", "ETag": etag}
        range_header = re.fullmatch(r"bytes=(\d+)-", request.headers.get("range", ""))
        if range_header is None or not self.service.ranges or request.headers.get("if-range") != etag:
            return 200, headers, data
        start = int(range_header[1])
        if start >= len(data):
            return _problem(416, "Range not satisfiable")
        extent = f"bytes {start}-{len(data) - 1}/{len(data)}"
        return 206, {**headers, "Content-Range": extent}, data[start:]

    def _create(self, request: Request) -> tuple[int, dict[str, str], bytes]:
        spec = json.loads(parts_of(request)["spec"][1])
        text = (spec["monitor"].get("u") or {}).get("expression", "")
        if "foo" in text:
            place = {"offset": text.index("foo"), "line": 1, "column": text.index("foo") + 1}
            errors = [{"pointer": "/monitor/u/expression", "message": "unknown name 'foo'", "position": place}]
            return _problem(422, "Invalid input", errors=errors)
        if request.query.get("store") == "false":
            aim = {"target": AIM} if "target" in spec else {}
            head = {"Content-Type": "application/x-npz", "Equimesh-Certificate": json.dumps(CERTIFICATE | aim)}
            if request.query["format"] == "xdmf":
                return 200, head, archive()
            return 200, head, mesh_file(**spec.get("grid") or {"n_xi": 4, "n_eta": 4})
        key = request.headers["idempotency-key"]
        if key not in self.service.keys:
            mesh_id = f"m{len(self.service.keys)}"
            self.service.keys[key] = mesh_id
            self.service.meshes[mesh_id] = {"id": mesh_id, "status": "queued", "spec": spec}
            self.service.looks[mesh_id] = 0
        mesh = self.service.meshes[self.service.keys[key]]
        if "prefer" in request.headers:
            self._look(mesh)
        status = 201 if mesh["status"] == "succeeded" else 202
        return _json(status, _public(mesh), {"Location": f"/v1/meshes/{mesh['id']}"})

    def _look(self, mesh: dict[str, Any]) -> None:
        if mesh["status"] not in ("queued", "running"):
            return
        self.service.looks[mesh["id"]] += 1
        looks, label = self.service.looks[mesh["id"]], mesh["spec"].get("label")
        mesh["status"] = "running"
        mesh["progress"] = {"stage": "newton", "iteration": looks, "residual": 0.1**looks, "fraction": looks / 4}
        if label == "fail":
            mesh["status"] = "failed"
            mesh["partial"] = True
            mesh["error"] = {"title": "Mesh folded", "detail": "At cell 3.", "remedy": "Lower a."}
        elif label != "hang" and (label != "slow" or looks >= 3):
            mesh["status"] = "succeeded"
        if mesh["status"] == "succeeded":
            mesh["convergence"] = {"status": "converged", "message": "The mesh satisfies the equations."}
        if label == "relaxed":
            mesh["certificate"] = CERTIFICATE

    def _list(self, request: Request) -> tuple[int, dict[str, str], bytes]:
        every = [_public(mesh) for mesh in reversed(self.service.meshes.values())]
        start = int(request.query.get("cursor", "0"))
        stop = start + min(2, int(request.query["limit"]))
        cursor = str(stop) if stop < len(every) else None
        return _json(200, {"items": every[start:stop], "next_cursor": cursor})

    def _check(self, sent: dict[str, Any]) -> tuple[int, dict[str, str], bytes]:
        text = sent["expression"]
        if "foo" in text:
            place = {"offset": text.index("foo"), "line": 1, "column": text.index("foo") + 1}
            errors = [{"pointer": "/expression", "message": "unknown name 'foo'", "position": place}]
            return _problem(422, "Invalid input", errors=errors)
        box = [[0, 1], [0, 1]] if "domain" not in sent else [[2, 4], [-1, 3]]
        return _json(200, {"names": ["x", "y"], "domain": {"box": box, "area": 1.0}})


def _public(mesh: dict[str, Any]) -> dict[str, Any]:
    told = {"label": mesh["spec"].get("label"), "grid": mesh["spec"].get("grid"), "points": 16}
    return {key: value for key, value in mesh.items() if key != "spec"} | told


def _json(status: int, value: Any, headers: dict[str, str] | None = None) -> tuple[int, dict[str, str], bytes]:
    return status, {"Content-Type": "application/json", **(headers or {})}, json.dumps(value).encode()


def _problem(status: int, title: str, **more: Any) -> tuple[int, dict[str, str], bytes]:
    data = json.dumps({"type": "/problems/x", "title": title, "status": status, **more}).encode()
    return status, {"Content-Type": "application/problem+json"}, data


def parts_of(request: Request) -> dict[str, tuple[str | None, bytes]]:
    """Name to (file name, bytes) of a multipart body; a JSON body is the part ``spec``."""
    kind = request.headers["content-type"]
    if not kind.startswith("multipart/"):
        return {"spec": (None, request.body)}
    message = BytesParser().parsebytes(b"Content-Type: " + kind.encode() + b"\r\n\r\n" + request.body)
    found = {}
    for part in message.get_payload():
        name = part.get_param("name", header="content-disposition")
        found[name] = (part.get_filename(), part.get_payload(decode=True))
    return found
