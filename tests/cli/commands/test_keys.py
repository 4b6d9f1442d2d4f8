"""The command makes, lists and revokes keys."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from equimesh_cli import main


def test_the_command_makes_lists_and_revokes_keys(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = ["--data-dir", str(tmp_path / "new")]
    assert main(["keys", "list", *folder]) == 2  # a slip in the folder's name makes no database
    assert main(["keys", "create", "--name", "ada", "--scope", "write", "--scope", "read", *folder]) == 0
    secret = capsys.readouterr().out.split()[0]
    assert re.fullmatch(r"em_[0-9a-f]{12}_[A-Za-z0-9_-]{43}", secret)
    assert main(["keys", "create", "--name", "bob", "--json", *folder]) == 0
    made = json.loads(capsys.readouterr().out)
    assert main(["keys", "list", "--json", *folder]) == 0
    out = capsys.readouterr().out
    assert [(key["name"], key["scopes"], key["revoked_at"]) for key in json.loads(out)] == [
        ("ada", ["read", "write"], None),
        ("bob", ["write"], None),
    ]
    assert main(["keys", "revoke", made["id"], *folder]) == 0
    assert main(["keys", "revoke", made["id"], *folder]) == 2
    assert main(["keys", "revoke", "none", *folder]) == 2
    assert main(["keys", "list", *folder]) == 0
    out += "".join(capsys.readouterr())
    assert all(word in out for word in ("ada", "bob", made["id"]))
    assert secret[-43:] not in out
    assert made["secret"][-43:] not in out


def test_keys_have_shares(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = ["--data-dir", str(tmp_path)]
    assert main(["keys", "create", "--name", "ada", "--json", *folder]) == 0
    ada = json.loads(capsys.readouterr().out)
    assert main(["keys", "create", "--name", "bob", "--share", "3", *folder]) == 0
    assert "share 3" in capsys.readouterr().out
    assert main(["keys", "change", ada["id"], "--share", "7", *folder]) == 0
    assert f"Key {ada['id']} (ada) has share 7." in capsys.readouterr().out
    assert main(["keys", "list", "--json", *folder]) == 0
    assert [(key["name"], key["share"]) for key in json.loads(capsys.readouterr().out)] == [("ada", 7), ("bob", 3)]
    assert main(["keys", "list", *folder]) == 0
    assert re.search(rf"^{ada['id']} +write +7 ", capsys.readouterr().out, re.MULTILINE)
    for share in ("0", "-1", "101"):
        assert main(["keys", "change", ada["id"], "--share", share, *folder]) == 2
        assert main(["keys", "create", "--name", "eve", "--share", share, *folder]) == 2
        assert "the share of a key is 1 to 100" in capsys.readouterr().err
    assert main(["keys", "change", "none", "--share", "1", *folder]) == 2
    assert main(["keys", "revoke", ada["id"], *folder]) == 0
    assert main(["keys", "change", ada["id"], "--share", "1", *folder]) == 2
    assert "is revoked" in capsys.readouterr().err
