"""VTK XML files of several blocks: the head, which names a structured grid for each block."""

from collections.abc import Sequence
from xml.sax.saxutils import quoteattr


def vtm_text(blocks: Sequence[tuple[str, str]]) -> str:
    """The head: each block has a name, and the name of a ``vts`` file in the same folder."""
    rows = [
        f"  <DataSet index={quoteattr(str(number))} name={quoteattr(name)} file={quoteattr(file)}/>"
        for number, (name, file) in enumerate(blocks)
    ]
    lines = ['<?xml version="1.0"?>', '<VTKFile type="vtkMultiBlockDataSet" version="1.0">', "<vtkMultiBlockDataSet>"]
    return "\n".join([*lines, *rows, "</vtkMultiBlockDataSet>", "</VTKFile>"]) + "\n"
