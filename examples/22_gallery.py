"""The pictures of the gallery: runs the code of docs/gallery.md, block by block.

pip install 'equimesh[solver,plot]'
python 22_gallery.py --output ../docs/images/gallery
python 22_gallery.py --only ring flame
"""

import argparse
import os
import re
from pathlib import Path
from typing import Any

from PIL import Image

import equimesh as em

PAGE = Path(__file__).resolve().parent.parent / "docs" / "gallery.md"
BLOCK = re.compile(r'^```py\n(.*?"([\w-]+)\.png".*?)^```$', re.MULTILINE | re.DOTALL)
COLOURS = 160
"""Colours of a picture: a third of the bytes of all of them."""


def blocks() -> dict[str, str]:
    """The code of every problem, by the name of its picture."""
    return {name: code for code, name in BLOCK.findall(PAGE.read_text())}


def draw(name: str, code: str) -> str:
    """Run the code of a problem, which draws its picture in this folder, and say what the mesh is worth."""
    names: dict[str, Any] = {}
    exec(compile(code, f"{PAGE.name}, {name}", "exec"), names)
    solution, path = names["solution"], Path(f"{name}.png")
    compared = solution.against_initial if isinstance(solution, em.BlockSolution) else solution.against_uniform
    Image.open(path).convert("RGB").quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE).save(path, optimize=True)
    return f"{name:<15} error {compared.gain:.3g} times smaller"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    parser.add_argument("--only", nargs="+", choices=blocks(), help="these problems; all without it")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    os.chdir(options.output)
    for name, code in blocks().items():
        if options.only is None or name in options.only:
            print(draw(name, code))
