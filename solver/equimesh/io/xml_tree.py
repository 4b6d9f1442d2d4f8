"""The tree of an XML file that a caller sends: no document type, no entities, nothing from elsewhere."""

from typing import Final, NoReturn
from xml.etree import ElementTree
from xml.parsers import expat

from equimesh.errors import SamplesError

MAX_LEVELS: Final = 50
MAX_PARTS: Final = 100_000


def parse_xml(data: bytes, kind: str) -> ElementTree.Element:
    """The root of the tree of ``data``; messages call it a ``kind`` file.

    The parser itself stops at a document type, so that no encoding can hide one.
    Raises :class:`~equimesh.errors.SamplesError`.
    """
    if max(data.count(b"<"), data.count(b"=")) > MAX_PARTS:  # numbers, and what is packed, have next to none
        raise SamplesError(f"the {kind} file has more than {MAX_PARTS} elements or attributes")
    builder = ElementTree.TreeBuilder()
    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_LEVELS:
            raise SamplesError(f"the {kind} file is nested more than {MAX_LEVELS} levels deep")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def refuse(*_: object) -> NoReturn:
        raise SamplesError(f"the {kind} file declares a document type or entities: save it again without them")

    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, ValueError, LookupError) as error:  # the latter two for unknown encodings
        if isinstance(error, SamplesError):
            raise
        raise SamplesError(f"the {kind} file cannot be read: {str(error)[:200]}") from error
    return builder.close()
