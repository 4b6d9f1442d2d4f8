"""A service without a key serves only the machine that it runs on."""

from __future__ import annotations

from pathlib import Path

import pytest

from equimesh_cli import main
from equimesh_service import Settings, running
from equimesh_service.errors import ExposedError
from equimesh_service.store.store import Store
from equimesh_service.upkeep.exposure import check_exposure, is_loopback


@pytest.mark.parametrize(
    ("host", "inside"),
    [("127.0.0.1", True), ("127.9.9.9", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("::", False),
     ("10.0.0.7", False), ("", False), ("service.example", False), ("localhost.example", False)],
)  # fmt: skip
def test_which_addresses_only_this_machine_reaches(host: str, inside: bool) -> None:
    assert is_loopback(host) is inside


def test_others_are_not_served_without_a_key(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    public = ["serve", "--host", "0.0.0.0", "--port", "0", "--data-dir", str(tmp_path)]
    assert main(public) == 2
    told = capsys.readouterr().err
    assert f"`equimesh keys create --name NAME --scope write --data-dir {tmp_path}`" in told
    assert "--allow-anonymous true" in told
    settings = Settings(data_dir=tmp_path, host="0.0.0.0")
    with pytest.raises(ExposedError), running(settings):
        pass
    check_exposure(settings.model_copy(update={"allow_anonymous": True}))
    store = Store(settings.database)
    row, _ = store.keys.create("only", ["admin"])
    store.keys.revoke(row.id)  # it closed the service, and its end does not open it
    store.close()
    check_exposure(settings)
