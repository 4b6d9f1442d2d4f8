"""The text of an XDMF file with a time, which PyVista's reader needs and meshio's refuses."""

# How meshio begins and ends the grid of a file.
GRID, END = '<Grid Name="Grid">', "</Grid>"
# The text of an Information must be XML for meshio; this one says nothing.
NOTHING = "&lt;nothing/&gt;"


def with_time(text: str) -> str:
    """The same file with the time 0, readable by programs that know no time.

    meshio reads no grid with an element ``Time``, and skips what is inside an ``Information``. So a second grid with
    the time stands there, and the first one refers to it: readers that follow a ``Reference``, such as VTK's and with
    it PyVista's, take the second; dolfinx, meshio and the newer reader of ParaView take the first. Both point to the
    same arrays of the HDF5 file.

    Raises ``ValueError`` for a text that is not one grid.
    """
    head, grid, rest = text.partition(GRID)
    content, end, tail = rest.partition(END)
    if not grid or not end:
        raise ValueError("the text holds no grid")
    timed = f'{GRID}<Time Value="0"/>{content}{END}'
    reference = '<Grid Name="Grid" Reference="/Xdmf/Domain/Grid/Information/Grid">'
    return f'{head}{reference}{content}<Information Name="time" Value="0">{NOTHING}{timed}</Information>{END}{tail}'
