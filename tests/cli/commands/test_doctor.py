"""`equimesh doctor`: finds nothing where all is well, and every check can fail."""

from __future__ import annotations

import importlib.metadata
import json
import socket

import pytest

from equimesh_cli import main
from equimesh_cli.checks import installation, reach
from equimesh_cli.commands import doctor
from equimesh_client import Client
from equimesh_service import Settings
from service.databases import ADDRESS, NEEDED
from service.guarded import Guarded

pytestmark = pytest.mark.usefixtures("no_variables")


def test_all_is_well_here_and_nothing_is_left_behind(
    here: Settings, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in (ADDRESS, NEEDED):  # no settings, but of the tests
        monkeypatch.delenv(name, raising=False)
    words = ["doctor", "--data-dir", str(here.data_dir), "--port", "0", "--workers", "1", "--memory-limit", "16"]
    assert main([*words, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert [check["check"] for check in said["checks"]] == [
        name for name in doctor.HERE if name not in ("clock", "cluster")
    ]
    assert {check["check"] for check in said["checks"] if check["level"] != "ok"} <= {"disk"}
    assert not here.data_dir.exists()


def test_what_fails_is_said_with_a_remedy(
    here: Settings, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor, "HERE", {"folder": installation.folder, "exposure": reach.exposure})
    here.data_dir.write_text("a file")
    words = ["doctor", "--data-dir", str(here.data_dir), "--host", "0.0.0.0", "--allow-anonymous", "true"]
    assert main(words) == 1
    said = capsys.readouterr().out
    assert said.startswith(f"failed   folder       the data folder {here.data_dir} cannot be written: Not a dir")
    assert "\n                      -> let the user of the service write it, or choose another" in said
    assert said.endswith("\n2 checks: 1 failed, 1 with a warning\n")


def test_a_service_that_runs(
    url: str, guarded_service: Guarded, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It alone is looked at, and not this machine."""

    def check(url: str, key: str = "") -> tuple[int, dict[str, str]]:
        code = main(["doctor", "--json", "--url", url, "--key", key])
        return code, {check["check"]: check["level"] for check in json.loads(capsys.readouterr().out)["checks"]}

    assert check(url) == (0, dict.fromkeys(doctor.THERE, "ok"))
    with Client(url, key="") as client:
        assert not [mesh for mesh in client.meshes.list() if mesh.record["label"] == "doctor"]
    well = {"ready": "ok", "version": "ok"}
    assert check(guarded_service.url, guarded_service.key("write")[1])[0] == 0
    assert check(guarded_service.url) == (1, {**well, "key": "failed", "round trip": "warning"})
    reader = check(guarded_service.url, guarded_service.key("read")[1])
    assert reader == (0, {**well, "key": "ok", "round trip": "warning"})
    monkeypatch.setattr(importlib.metadata, "version", lambda _: "9.9")
    assert check(url)[1]["version"] == "warning"


@pytest.mark.parametrize("words", [["--stored"], ["--workers", "2"]])
def test_a_service_elsewhere_or_this_machine(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--url", "http://127.0.0.1:9", *words]) == 2
    assert "leave out one of them" in capsys.readouterr().err


def test_a_service_that_does_not_run(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        assert main(["doctor", "--url", f"http://127.0.0.1:{unused.getsockname()[1]}"]) == 1
    assert "does not answer (ConnectError)\n" in capsys.readouterr().out
