"""Arrays of VTK's XML files in every encoding that VTK knows, with a limit of their size."""

import base64
import binascii
import lzma
import mmap
import re
import sys
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from equimesh.errors import SamplesError
from equimesh.io.xml_tree import parse_xml
from equimesh.numerics.types import Array

XML_TYPES = {f"{kind}{bits}": f"{kind[0].lower()}{bits // 8}" for kind in ("Int", "UInt") for bits in (8, 16, 32, 64)}
XML_TYPES |= {"Float32": "f4", "Float64": "f8"}
HEADER_TYPES = {"UInt32": "u4", "UInt64": "u8"}
DECOMPRESSORS: dict[str, Callable[[], Any]] = {
    "vtkZLibDataCompressor": zlib.decompressobj,
    "vtkLZMADataCompressor": partial(lzma.LZMADecompressor, memlimit=2**26),
}
# What a broken file raises besides.
BROKEN: Final = (KeyError, ValueError, binascii.Error, zlib.error, lzma.LZMAError)
# The least bytes of a compressed block, but for the last one; VTK's have 32768 of them.
MIN_BLOCK: Final = 512


class VtkXml:
    """One VTK XML file: its tree ``root``, and how its arrays are encoded.

    Reads every encoding: text, inline base64, appended base64 or raw, uncompressed or with zlib or LZMA. At most
    ``max_bytes`` of arrays are decoded. Raises :class:`~equimesh.errors.SamplesError`.
    """

    def __init__(self, data: bytes | mmap.mmap, max_bytes: int) -> None:
        end = data.find(b"<AppendedData")
        self.root = parse_xml(data[:] if end < 0 else data[:end] + b"</VTKFile>", "vtu")
        if self.root.tag != "VTKFile":
            raise SamplesError(f"the vtu file starts with <{self.root.tag}>, not with <VTKFile>")
        self.budget = max_bytes
        begin = data.find(b"_", end) + 1 if end >= 0 else 0
        self.appended = memoryview(data)[begin if begin else len(data) :]
        self.raw = re.search(rb"""encoding\s*=\s*["']raw""", data[end:begin] if begin else b"") is not None
        self.order: Literal["<", ">"] = ">" if self.root.get("byte_order") == "BigEndian" else "<"
        self.header = np.dtype(HEADER_TYPES[self.root.get("header_type", "UInt32")]).newbyteorder(self.order)
        compressor = self.root.get("compressor")
        if compressor is not None and compressor not in DECOMPRESSORS:
            raise SamplesError(f"the vtu file is compressed by {compressor}: save it with zlib or uncompressed")
        self.decompressor = DECOMPRESSORS.get(compressor) if compressor else None

    @classmethod
    def mapped(cls, path: Path) -> "VtkXml":
        """The file at ``path``, of which only what is read comes into memory. Raises ``OSError``."""
        with path.open("rb") as file:
            return cls(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), sys.maxsize)

    def array(self, element: ElementTree.Element, size: int) -> Array:
        """The ``size`` numbers of a DataArray in double precision; integers up to 2**53 stay exact.

        Raises what :meth:`stored` raises.
        """
        return self.stored(element, size).astype(np.float64)

    def stored(self, element: ElementTree.Element, size: int) -> npt.NDArray[Any]:
        """The ``size`` numbers of a DataArray, of the type that the file has; those of a text in double precision.

        Plain bytes that follow the text are not copied. Raises :class:`~equimesh.errors.SamplesError`, and the errors
        of broken encodings (``BROKEN``).
        """
        name = element.get("Name", "points")
        dtype = np.dtype(XML_TYPES[element.attrib["type"]]).newbyteorder(self.order)
        self.budget -= size * 8
        if size < 0 or self.budget < 0:
            raise SamplesError(f"the vtu file holds more data than the limit allows (reached at {name!r})")
        form = element.get("format", "ascii")
        if form == "ascii":
            values: npt.NDArray[Any] = np.array((element.text or "").split(None, size)[: size + 1], dtype=np.float64)
        else:
            block, raw = memoryview((element.text or "").strip().encode()), False
            if form == "appended":
                block, raw = self.appended[int(element.attrib["offset"]) :], self.raw
            values = np.frombuffer(self._decoded(block, raw, size * dtype.itemsize), dtype)
        if values.size != size:
            raise SamplesError(f"array {name!r} of the vtu file has {values.size} numbers where {size} are expected")
        return values

    def _decoded(self, block: memoryview, raw: bool, expected: int) -> bytes | memoryview:
        """The bytes of a block, which must be ``expected`` in number."""
        item = self.header.itemsize
        if self.decompressor is None:
            found = _take(block, raw, item + expected)
            declared = int(np.frombuffer(found[:item], self.header)[0])
            if declared != expected:
                raise SamplesError(f"an array of the vtu file has {declared} bytes where {expected} are expected")
            return found[item:]
        blocks = int(np.frombuffer(_take(block, raw, item), self.header)[0])
        if blocks > len(block) // item:
            raise SamplesError("an array of the vtu file ends too early")
        if blocks > 1 + expected // MIN_BLOCK:
            raise SamplesError(f"an array of the vtu file has {blocks} blocks for {expected} bytes: save larger blocks")
        sizes = np.frombuffer(_take(block, raw, (3 + blocks) * item), self.header)[3:].astype(object)
        start = (3 + blocks) * item if raw else -(-(3 + blocks) * item // 3) * 4  # the header is encoded by itself
        packed, done, at = _take(block[start:], raw, int(sum(sizes))), bytearray(), 0
        for size in sizes:
            done += self.decompressor().decompress(packed[at : at + size], expected - len(done) + 1)
            at += size
            if len(done) > expected:
                break
        if len(done) != expected:
            raise SamplesError(f"an array of the vtu file does not expand to the {expected} bytes expected")
        return bytes(done)


def _take(block: memoryview, raw: bool, count: int) -> bytes | memoryview:
    """The first ``count`` bytes of a raw or base64 block."""
    found = block[:count] if raw else base64.b64decode(block[: -(-count // 3) * 4])[:count]
    if len(found) != count:
        raise SamplesError("an array of the vtu file ends too early")
    return found
