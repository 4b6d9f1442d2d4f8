"""What the image, a machine and the tests install is named by its bytes."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
PINS = re.compile(r"^([A-Za-z0-9_.-]+)==(\S+)(.*)$", re.MULTILINE)


def pins(file: str) -> dict[str, str]:
    """The versions that a file names, by the normalised names of the packages."""
    found = PINS.findall((ROOT / file).read_text())
    return {re.sub(r"[-_.]+", "-", name).lower(): version for name, version, _ in found}


@pytest.mark.parametrize("file", ["deploy/locked.txt", "deploy/locked-site.txt", ".ci/locked.txt"])
def test_what_is_installed_is_locked_by_its_bytes(file: str) -> None:
    known, locked = pins("constraints.txt"), pins(file)
    assert locked.items() <= known.items()
    text = (ROOT / file).read_text()
    for entry in re.split(r"\n(?=\w)", text)[1:]:
        assert re.match(r"\S+==\S+ \\\n    --hash=sha256:[0-9a-f]{64}", entry), entry
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    extras = project["project"]["optional-dependencies"]
    groups = {
        "deploy/locked.txt": ("solver", "plot", "service", "postgres", "s3", "tracing", "dask"),
        "deploy/locked-site.txt": ("site",),
        ".ci/locked.txt": extras.keys() - {"notebook"},  # no test starts JupyterLab
    }
    wanted = [*project["project"]["dependencies"]]
    wanted += [] if file == "deploy/locked-site.txt" else project["build-system"]["requires"]
    for group in groups[file]:
        wanted += extras[group]
    for text in wanted:
        requirement = Requirement(text)
        if requirement.name != "equimesh":
            found = locked[requirement.name.replace("_", "-").lower()]
            assert requirement.specifier.contains(found, prereleases=True), text
