"""Keys in the store."""

from __future__ import annotations

from pathlib import Path

import pytest

from equimesh_service import Settings
from equimesh_service.store.store import Store


def test_a_scope_must_exist(tmp_path: Path) -> None:
    store = Store(Settings(data_dir=tmp_path).database)
    store.prepare()
    for scopes in ((), ("root",)):
        with pytest.raises(ValueError, match="scopes are read, write, admin"):
            store.keys.create("x", scopes)
    store.close()
