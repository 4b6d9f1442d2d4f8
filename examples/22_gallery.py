"""The pictures of the gallery: runs the code of docs/gallery.md, block by block.

pip install 'equimesh[solver,plot]'
python 22_gallery.py --only ring flame
python 22_gallery.py --output ../docs/images/gallery --page   # also the numbers in the page
"""

import argparse
import os
import re
from pathlib import Path
from typing import Any

from PIL import Image

PAGE = Path(__file__).resolve().parent.parent / "docs" / "gallery.md"
BLOCK = re.compile(r'^```py\n(.*?"([\w-]+)\.png".*?)^```$', re.MULTILINE | re.DOTALL)
COLOURS = 256
"""Colours of a picture: less than half of the bytes of all of them."""


def blocks() -> dict[str, str]:
    """The code of every problem, by the name of its picture."""
    return {name: code for code, name in BLOCK.findall(PAGE.read_text())}


def draw(name: str, code: str) -> float:
    """Run the code of a problem, which draws its picture in this folder; the gain of its mesh."""
    names: dict[str, Any] = {}
    exec(compile(code, f"{PAGE.name}, {name}", "exec"), names)
    solution, path = names["solution"], Path(f"{name}.png")
    compared = solution.against_uniform
    picture = Image.open(path).convert("RGB")
    picture.quantize(COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(path, optimize=True)
    return float(compared.gain or 0.0)


def tell(name: str, gain: float) -> None:
    """Write the number below a picture into the page."""
    told = rf"(the error is )\S+( times smaller\]\(images/gallery/{name}\.png\))"
    PAGE.write_text(re.sub(told, rf"\g<1>{gain:.3g}\g<2>", PAGE.read_text()))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    parser.add_argument("--only", nargs="+", choices=blocks(), help="these problems; all without it")
    parser.add_argument("--page", action="store_true", help="write the numbers into the page, too")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    os.chdir(options.output)
    for name, code in blocks().items():
        if options.only is None or name in options.only:
            gain = draw(name, code)
            print(f"{name:<15} error {gain:.3g} times smaller", flush=True)
            if options.page:
                tell(name, gain)
