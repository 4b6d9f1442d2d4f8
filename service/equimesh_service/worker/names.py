"""The names of the artifacts of a mesh."""

MESH, CONVERGENCE = "mesh", "convergence"


def file_name(format: str, cells: str) -> str:
    """Name of the artifact that is the mesh in a format; npz with quads is the mesh as it was computed."""
    return MESH if (format, cells) == ("npz", "quad") else f"file:{format}:{cells}"


ARRAYS = "quality:arrays"


PLOTS = ("mesh", "convergence", "quality")


PICTURES = {"svg": "image/svg+xml", "png": "image/png"}


def plot_name(kind: str, format: str) -> str:
    """Name of the artifact that is a picture."""
    return f"plot:{kind}:{format}"
