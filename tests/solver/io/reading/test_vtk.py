"""Arrays of VTK's XML files: text and packed, their types, and the limit of their size."""

from __future__ import annotations

import base64
import struct

import numpy as np
import pytest

from equimesh.errors import SamplesError
from equimesh.io.reading.vtk import VtkXml

PACKED = base64.b64encode(struct.pack("<I3i", 12, 5, -6, 2**30)).decode()


def reader(array: str, limit: int = 1000) -> VtkXml:
    return VtkXml(f'<VTKFile byte_order="LittleEndian"><a>{array}</a></VTKFile>'.encode(), limit)


@pytest.mark.parametrize(
    "array",
    [
        f'<DataArray type="Int32" format="binary">{PACKED}</DataArray>',
        f'<DataArray type="Int64" format="ascii">5 -6 {2**30}</DataArray>',
    ],
)
def test_numbers_of_both_encodings(array: str) -> None:
    found = reader(array)
    np.testing.assert_array_equal(found.array(found.root[0][0], 3), [5, -6, 2**30])
    with pytest.raises(SamplesError, match=r"where 4 are expected|ends too early"):
        found.array(found.root[0][0], 4)


def test_more_than_the_limit_is_refused_before_it_is_read() -> None:
    found = reader('<DataArray type="Int64" Name="q" format="ascii">5</DataArray>', limit=7)
    with pytest.raises(SamplesError, match="more data than the limit allows"):
        found.array(found.root[0][0], 1)


def test_another_compressor_is_named() -> None:
    with pytest.raises(SamplesError, match="compressed by vtkLZ4"):
        VtkXml(b'<VTKFile compressor="vtkLZ4"></VTKFile>', 10)


def test_more_blocks_than_bytes_are_refused() -> None:
    packed = base64.b64encode(struct.pack("<1003I", 1000, 1, 0, *[0] * 1000)).decode()
    array = f'<DataArray type="Int32" Name="q" format="binary">{packed}</DataArray>'
    file = f'<VTKFile compressor="vtkZLibDataCompressor" byte_order="LittleEndian"><a>{array}</a></VTKFile>'
    found = VtkXml(file.encode(), 1000)
    with pytest.raises(SamplesError, match="has 1000 blocks for 12 bytes: save larger blocks"):
        found.array(found.root[0][0], 3)
