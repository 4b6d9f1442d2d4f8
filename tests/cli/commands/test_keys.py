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
