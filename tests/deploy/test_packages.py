"""What packages equimesh beside pip: the recipe for conda, and the image of the notebook server."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import yaml

from generator.staging import OPEN

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
ON_CONDA = {"matplotlib": "matplotlib-base"}


def test_the_recipe_for_conda_has_the_requirements_of_the_project() -> None:
    recipe = yaml.safe_load((ROOT / "deploy/conda/recipe.yaml").read_text())
    wanted = PROJECT["dependencies"] + [
        text for extra in ("solver", "plot") for text in PROJECT["optional-dependencies"][extra]
    ]
    names = [re.fullmatch(r"([\w.-]+)(.*)", text).groups() for text in wanted]  # type: ignore[union-attr]
    run = recipe["requirements"]["run"]
    assert run[0] == "python >=${{ python_min }}"
    assert sorted(run[1:]) == sorted(f"{ON_CONDA.get(name, name)} {versions}" for name, versions in names)
    assert recipe["context"]["version"] == PROJECT["version"]
    assert recipe["build"]["python"]["entry_points"] == [f"equimesh = {PROJECT['scripts']['equimesh']}"]
    assert (ROOT / "deploy/conda" / recipe["source"]["path"] / recipe["about"]["license_file"]).exists()


def test_the_notebook_server_is_built_from_what_the_context_holds() -> None:
    found = yaml.safe_load((ROOT / "deploy/notebook.yaml").read_text())["services"]["notebook"]
    copied = re.findall(r"^COPY (.+) \S+$", found["build"]["dockerfile_inline"], re.MULTILINE)
    known = (ROOT / ".dockerignore").read_text().split()
    assert len(copied) == 6
    assert "127.0.0.1:8888:8888" in found["ports"]  # where pages of notebooks say that they run
    assert "http://localhost:8888/lab/tree/first_mesh.ipynb" in OPEN.format("first_mesh.ipynb")
    assert "RUN cp /src/examples/notebooks/*.ipynb ." in found["build"]["dockerfile_inline"]
    assert '"http://127.0.0.1:8000' in (ROOT / "examples/notebooks/over_http.ipynb").read_text().replace("\\", "")
    assert "sed --in-place s,//127.0.0.1:8000,//equimesh:8000, *.ipynb" in found["build"]["dockerfile_inline"]
    assert all(f"!{name}" in known for line in copied for name in line.split())
    services = yaml.safe_load((ROOT / "compose.yaml").read_text())["services"]
    assert found["depends_on"].keys() <= services.keys()
    assert services["equimesh"]["environment"]["EQUIMESH_ALLOWED_HOSTS"].endswith(":-equimesh}")  # its name there
    images = [found["image"], *(one["image"] for one in services.values() if one["image"].startswith("equimesh"))]
    assert {image.partition(":")[2] for image in images} == {PROJECT["version"]}
