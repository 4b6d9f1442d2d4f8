"""The time of an XDMF file; readers of several programs take it in tests/solvers."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest

from equimesh.io.solver_files import with_time

TEXT = '<Xdmf Version="3.0"><Domain><Grid Name="Grid"><Geometry/><Topology/></Grid></Domain></Xdmf>'


def test_the_grid_refers_to_one_with_a_time() -> None:
    root = ET.fromstring(with_time(TEXT))
    (grid,) = root.findall("Domain/Grid")
    assert [child.tag for child in grid] == ["Geometry", "Topology", "Information"]
    referred = root.find("." + grid.attrib["Reference"].removeprefix("/Xdmf"))
    assert referred is not None
    assert [child.tag for child in referred] == ["Time", "Geometry", "Topology"]
    assert referred[0].attrib == {"Value": "0"}
    assert ET.fromstring(grid[2].text or "").tag == "nothing"  # meshio reads this text as XML


@pytest.mark.parametrize("text", ["", "<Xdmf/>", '<Grid Name="Grid">'])
def test_a_text_without_a_grid_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="holds no grid"):
        with_time(text)
