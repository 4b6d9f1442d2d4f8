"""The names of the artifacts of a mesh."""

# The mesh as it was computed.
MESH = "mesh"
# The history of the Schwarz iteration.
CONVERGENCE = "convergence"
# The quality of each cell.
ARRAYS = "quality:arrays"
# All that a page needs to draw the mesh.
DRAWING = "drawing"
# The kinds of pictures.
PLOTS = ("mesh", "convergence", "quality", "comparison")
# The media types of pictures, by their formats.
PICTURES = {"svg": "image/svg+xml", "png": "image/png"}


def file_name(format: str, cells: str) -> str:
    """The name of the artifact of a mesh in a format; npz with quads is the mesh as it was computed."""
    return MESH if (format, cells) == ("npz", "quad") else f"file:{format}:{cells}"


def plot_name(kind: str, format: str) -> str:
    """The name of the artifact of a picture."""
    return f"plot:{kind}:{format}"


def head_name(format: str) -> str:
    """The name of the artifact of the head of a mesh in parts, which names the files of its parts."""
    return f"head:{format}"


def part_name(format: str, number: int) -> str:
    """The name of the artifact of a part, whose numbers are 0, 1, 2, …."""
    return f"part:{format}:{number}"
