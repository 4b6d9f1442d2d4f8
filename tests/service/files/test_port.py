"""Every implementation of files keeps the contract of the port."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from equimesh_service.files.port import Files
from service.files.check_files import CHECKS


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_an_implementation_of_files(check: Callable[[Files, Path], None], files: Files, tmp_path: Path) -> None:
    check(files, tmp_path)
