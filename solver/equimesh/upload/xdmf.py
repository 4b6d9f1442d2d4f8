"""Points and point data of an XDMF file that a caller sends: a zip of ``.xdmf`` and ``.h5``, or ``.xdmf`` alone.

Alone it holds its numbers as text. The XML names its arrays as ``mesh.h5:/data0``: the file must be a member of the
zip, and the array a plain one inside it. No other file is ever opened.
"""

import io
import zlib
from collections.abc import Callable
from typing import Any, Final, TypeAlias
from xml.etree import ElementTree

import h5py
import numpy as np

from equimesh.errors import SamplesError
from equimesh.io.xml_tree import parse_xml
from equimesh.io.zip_members import Members, open_zip
from equimesh.numerics.types import Array
from equimesh.upload.limits import Limits

Cloud: TypeAlias = tuple[Array, dict[str, Array]]
ReadMember: TypeAlias = Callable[[str], bytes]

COMPONENTS: Final = {"XY": 2, "XYZ": 3}
FILTERS: Final = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
# MemoryError: the library trusts the sizes in a broken header.
_BROKEN = (OSError, RuntimeError, LookupError, ValueError, TypeError, OverflowError, MemoryError, zlib.error)
REMEDY = "send the zip of an .xdmf and its .h5 file, as GET /v1/meshes/{id}/file?format=xdmf gives it"
AS_ARRAYS = "dolfinx writes such files; send the points and values of the function in an .npz file instead"


def read_xdmf(data: bytes, limits: Limits) -> Cloud:
    """Points, shape ``(n, 2)``, and the scalar point data by name, each ``(n,)``, of the first grid.

    Of several ``.xdmf`` members the first is read. Raises :class:`~equimesh.errors.SamplesError`.
    """
    if not data.startswith(b"PK"):
        return _XdmfReader(data, _no_member, limits).read()
    with open_zip(data, "xdmf", limits.max_bytes, REMEDY) as members:
        descriptions = [name for name in members.names if name.endswith(".xdmf")]
        if not descriptions:
            raise SamplesError(f"the zip file has no member that ends in .xdmf: {REMEDY}")
        return _XdmfReader(members.read(descriptions[0]), _member_of(members), limits).read()


def _no_member(name: str) -> bytes:
    raise SamplesError(f"the xdmf file refers to {name[:80]!r}: {REMEDY}")


def _member_of(members: Members) -> ReadMember:
    read: dict[str, bytes] = {}

    def member(name: str) -> bytes:
        if name not in members.names:
            raise SamplesError(f"the xdmf file refers to {name[:80]!r}, which is no member of the zip file")
        if name not in read:
            read[name] = members.read(name)
        return read[name]

    return member


class _XdmfReader:
    """One XDMF description, and how the arrays are found that it names."""

    def __init__(self, description: bytes, member: ReadMember, limits: Limits) -> None:
        self.root = parse_xml(description, "xdmf", AS_ARRAYS)
        self.member, self.budget, self.limits = member, limits.max_bytes, limits
        if self.root.tag != "Xdmf":
            raise SamplesError(f"the xdmf file starts with <{self.root.tag[:40]}>, not with <Xdmf>")

    def read(self) -> Cloud:
        grid = self.root.find("Domain/Grid")
        while grid is not None and grid.get("GridType", "Uniform") != "Uniform":
            grid = grid.find("Grid")
        geometry = None if grid is None else grid.find("Geometry")
        if grid is None or geometry is None:
            raise SamplesError("the xdmf file has no Grid with a Geometry: save the points of one mesh")
        kind = geometry.get("GeometryType", geometry.get("Type", "XYZ"))
        if kind.upper() not in COMPONENTS:
            raise SamplesError(f"the geometry of the xdmf file is {kind[:40]!r}: save its points as XY or XYZ")
        width = COMPONENTS[kind.upper()]
        points = self._array(geometry, "points", width).ravel()
        if points.size % width:
            raise SamplesError(f"the xdmf file has {points.size} coordinates, not {width} for each point")
        points = points.reshape(-1, width)[:, :2]
        fields = {}
        for attribute in grid.iterfind("Attribute"):
            scalar = attribute.get("AttributeType", attribute.get("Type", "Scalar")) == "Scalar"
            if scalar and attribute.get("Center", "Node") == "Node":
                name = attribute.get("Name", "")
                fields[name] = values = self._array(attribute, name).ravel()
                if len(values) != len(points):
                    raise SamplesError(f"point data {name[:40]!r} has {len(values)} values for {len(points)} points")
        return points, fields

    def _array(self, owner: ElementTree.Element, name: str, width: int = 1) -> Array:
        """The numbers of the one DataItem of an element, ``width`` for each point."""
        items = owner.findall("DataItem")
        if len(items) != 1 or len(items[0]) or {"Reference", "ItemType"} & set(items[0].attrib):
            raise SamplesError(f"{name[:40]!r} of the xdmf file is not one plain DataItem: save it as one array")
        item = items[0]
        sizes = item.get("Dimensions", "").split()
        if not 0 < len(sizes) <= 3 or not all(size.isdecimal() and len(size) < 12 for size in sizes):
            raise SamplesError(f"{name[:40]!r} of the xdmf file has Dimensions {item.get('Dimensions')!r:.40}")
        shape = tuple(map(int, sizes))
        count = 1
        for size in shape:
            count *= size
        self.limits.check(count // width)
        self.budget -= 8 * count
        if self.budget < 0:
            raise SamplesError(f"the xdmf file holds more data than the limit allows (reached at {name[:40]!r})")
        form, text = item.get("Format", "XML").upper(), item.text or ""
        if form not in ("XML", "HDF"):
            raise SamplesError(f"{name[:40]!r} of the xdmf file has the format {form[:20]!r}: save it as XML or HDF")
        values = _numbers(text, count, name) if form == "XML" else self._heavy(text.strip(), count, name)
        if values.size != count:
            raise SamplesError(f"{name[:40]!r} of the xdmf file has {values.size} numbers where {count} are expected")
        return values.reshape(shape)

    def _heavy(self, reference: str, count: int, name: str) -> Array:
        file, colon, path = reference.partition(":")
        if not colon:
            raise SamplesError(f"{name[:40]!r} of the xdmf file is no array of an .h5 file, such as mesh.h5:/data0")
        return _read_hdf5(self.member(file), path, count, name)


def _numbers(text: str, count: int, name: str) -> Array:
    """The numbers of a text: ``count``, or one more that shows that there are too many."""
    try:
        return np.array(text.split(None, count)[: count + 1], dtype=np.float64)
    except ValueError as error:
        raise SamplesError(f"{name[:40]!r} of the xdmf file cannot be read: {str(error)[:200]}") from error


def _read_hdf5(data: bytes, path: str, count: int, name: str) -> Array:
    """An array of ``count`` numbers of an HDF5 file: stored in this file, in no form that expands beyond it."""
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            dataset = _found(file, path)
            if dataset.size != count or dataset.dtype.kind not in "fiu" or dataset.dtype.itemsize > 8:
                raise SamplesError(
                    f"{name[:40]!r} of the xdmf file has {dataset.size} entries of type {dataset.dtype} where "
                    f"{count} numbers are expected"
                )
            if dataset.external or dataset.is_virtual:
                raise SamplesError(f"{name[:40]!r} of the xdmf file lies in another file: save it as one array")
            _check_chunks(dataset, name, len(data))
            with np.errstate(all="ignore"):
                return np.asarray(dataset[()], dtype=np.float64)
    except SamplesError:
        raise
    except _BROKEN as error:
        raise SamplesError(f"the h5 file with {name[:40]!r} cannot be read: {str(error)[:200]}") from error


def _found(file: h5py.File, path: str) -> Any:
    """The dataset at a path of which no part is a link to elsewhere."""
    here: Any = file
    for part in path.strip("/").split("/"):
        if not isinstance(here, h5py.Group) or not isinstance(here.get(part, getlink=True), h5py.HardLink):
            raise SamplesError(f"the h5 file has no array {path[:80]!r}")
        here = here[part]
    if not isinstance(here, h5py.Dataset):
        raise SamplesError(f"{path[:80]!r} in the h5 file is no array")
    return here


def _check_chunks(dataset: Any, name: str, file_size: int) -> None:
    """Refuse chunks that are larger than the file or expand beyond their size, before the library reads them."""
    if dataset.chunks is None:
        return
    pipeline = dataset.id.get_create_plist()
    filters = [pipeline.get_filter(k)[0] for k in range(pipeline.get_nfilters())]
    size = int(np.prod(dataset.chunks, dtype=object)) * dataset.dtype.itemsize
    if not set(filters) <= FILTERS or size > 16 * dataset.size * 8 + 2**20:
        raise SamplesError(f"{name[:40]!r} of the xdmf file is packed in an unusual way: save it with gzip or plain")
    if h5py.h5z.FILTER_DEFLATE not in filters:
        return
    for number in range(dataset.id.get_num_chunks()):
        chunk = dataset.id.get_chunk_info(number)
        if chunk.size > file_size:
            raise SamplesError(f"{name[:40]!r} of the xdmf file has a part that is larger than its h5 file")
        mask, packed = dataset.id.read_direct_chunk(chunk.chunk_offset)
        if mask:
            raise SamplesError(f"{name[:40]!r} of the xdmf file leaves out a step of its packing: save it again")
        if len(zlib.decompressobj().decompress(packed, size + 5)) > size + 4:  # 4: the sum of FLETCHER32
            raise SamplesError(f"{name[:40]!r} of the xdmf file expands to more than its stated size")
