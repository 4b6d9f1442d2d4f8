"""Notebooks as pages: their cells as Markdown with what is stored of their output, and their output made anew.

``PYTHONPATH=docs python -m generator.notebooks`` runs all notebooks, one after the other, and stores what they show.
"""

from __future__ import annotations

import ast
import base64
import io
import json
import os
import sys
import tempfile
from contextlib import chdir, redirect_stdout
from pathlib import Path
from typing import Any

from generator.places import ROOT

FOLDER = ROOT / "examples" / "notebooks"
RESOLUTION = 80
"""Dots per inch of a figure."""


def markdown_of(path: Path) -> str:
    """The page of a notebook: its words, its code, and its stored output. What it prints follows "It prints:"."""
    pieces = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            pieces.append(text)
            continue
        pieces.append(f"```python\n{text}\n```")
        pieces += [_shown(output) for output in cell["outputs"]]
    return "\n\n".join(pieces) + "\n"


def _shown(output: dict[str, Any]) -> str:
    """One output as Markdown: text, a table with its picture, or a picture."""
    if output["output_type"] == "stream":
        return "It prints:\n\n```text\n{}```".format("".join(output["text"]))
    data = {kind: "".join(text) for kind, text in output["data"].items()}
    if "text/html" in data:
        return data["text/html"]
    return f'<img alt="the figure of this code" src="data:image/png;base64,{data["image/png"].strip()}">'


def with_output(notebook: dict[str, Any], name: str) -> dict[str, Any]:
    """The notebook with the output of a run in this process, as a kernel makes it; ``name`` is for tracebacks."""
    program: dict[str, Any] = {"__name__": "__main__"}
    cells = []
    for number, cell in enumerate(notebook["cells"], start=1):
        if cell["cell_type"] == "code":
            cell = {**cell, "outputs": _outputs("".join(cell["source"]), program, f"{name}, cell {number}")}
        cells.append(cell)
    return {**notebook, "cells": cells}


def _outputs(code: str, program: dict[str, Any], place: str) -> list[dict[str, Any]]:
    """What a cell shows: what it prints, its last value unless a semicolon ends it, and figures of pyplot."""
    tree, said, value = ast.parse(code), io.StringIO(), None
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    with redirect_stdout(said):
        exec(compile(tree, place, "exec"), program)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), place, "eval"), program)
    outputs = []
    if said.getvalue():
        text = said.getvalue().splitlines(keepends=True)
        outputs.append({"output_type": "stream", "name": "stdout", "text": text})
    if hasattr(value, "_repr_html_") and not code.rstrip().endswith(";"):
        data = {"text/html": [value._repr_html_()], "text/plain": [repr(value)]}
        outputs.append({"output_type": "display_data", "data": data, "metadata": {}})
    return [*outputs, *_figures()]


def _figures() -> list[dict[str, Any]]:
    """The open figures of pyplot, which are closed."""
    pyplot = sys.modules.get("matplotlib.pyplot")
    found = []
    for number in pyplot.get_fignums() if pyplot else ():
        file = io.BytesIO()
        pyplot.figure(number).savefig(
            file, format="png", dpi=RESOLUTION, bbox_inches="tight", metadata={"Software": None}
        )
        data = {"image/png": base64.b64encode(file.getvalue()).decode()}
        found.append({"output_type": "display_data", "data": data, "metadata": {}})
    if pyplot:
        pyplot.close("all")
    return found


def main() -> None:
    """Run all notebooks against a service of their own, and store their output."""
    from equimesh_service import Settings, running

    os.environ["MPLBACKEND"] = "agg"
    wanted = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        settings = Settings(port=8000, workers=1, data_dir=Path(folder), log_level="warning")
        with running(settings):
            for path in sorted(FOLDER.glob("*.ipynb")):
                if not wanted or path.stem in wanted:
                    notebook = with_output(json.loads(path.read_text(encoding="utf-8")), path.name)
                    path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
