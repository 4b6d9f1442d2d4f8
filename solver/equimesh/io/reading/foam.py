"""Dictionaries of OpenFOAM as tokens, and the meshes of polyMesh."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Final, TypeAlias

import numpy as np

from equimesh.io.reading.bounds import bad_file, floats, integers, line_of
from equimesh.io.reading.plain_mesh import PLANE, PlainMesh, refuse_cell
from equimesh.numerics.types import Array, IntArray

# OpenFOAM's dictionaries, their literal subset: entries, lists and numbers, without code and calculations.

# Lists and dictionaries inside each other, at most.
MAX_DEPTH: Final = 32
# Words of a file, and words that variables may bring, in all.
MAX_WORDS: Final = 500_000

_TOKEN = re.compile(r'//[^\n]*|/\*.*?(?:\*/|\Z)|"(?:[^"\\]|\\.)*+(?:"|\\?\Z)|[(){}\[\];]|[^\s(){}\[\];"]+', re.DOTALL)
_VARIABLE = re.compile(r"\$([A-Za-z_][\w.]*)|\$\{([A-Za-z_][\w.]*)\}")


@dataclass(frozen=True)
class Word:
    """One word or number of a file, and its line."""

    text: str
    line: int

    def number(self) -> float:
        """The word as a number; raises :class:`~equimesh.errors.InputError` with the line."""
        try:
            return float(self.text)
        except ValueError:
            raise bad_file(f"line {self.line}: {self.text[:30]!r} is no number") from None

    def integer(self) -> int:
        """The word as an integer; raises :class:`~equimesh.errors.InputError` with the line."""
        try:
            return int(self.text)
        except ValueError:
            raise bad_file(f"line {self.line}: {self.text[:30]!r} is no integer") from None


@dataclass(frozen=True)
class Items:
    """The items between ``(`` and ``)``, and the line of the first."""

    items: Sequence[Item]
    line: int


@dataclass(frozen=True)
class Entries:
    """The entries between ``{`` and ``}``: for each name its items, and the line of the first."""

    values: Mapping[str, Sequence[Item]]
    line: int


Item: TypeAlias = Word | Items | Entries


@dataclass
class Dictionary:
    """A file: for each name its items, in the order of the file; ``loose`` are those without a name, as in a list."""

    values: dict[str, list[Item]] = field(default_factory=dict)
    loose: list[Item] = field(default_factory=list)


def parse(text: str) -> Dictionary:
    """The entries of a dictionary, or the items of a file that is one list.

    A variable ``$name`` brings the items of an entry before it. Code, calculations, other files and other variables
    are refused. Raises :class:`~equimesh.errors.InputError` with the line.
    """
    return _Parser(text).file()


class _Parser:
    def __init__(self, text: str) -> None:
        self.words = list(islice(_words(text), MAX_WORDS + 1))
        if len(self.words) > MAX_WORDS:
            raise bad_file(f"line {self.words[-1].line}: the file has more than {MAX_WORDS} words")
        self.at, self.taken, self.lines = 0, 0, text.count("\n") + 1
        self.known: dict[str, list[Item]] = {}

    def file(self) -> Dictionary:
        result = Dictionary(values=self.known)
        while self.at < len(self.words):
            word = self.words[self.at]
            if word.text == "(" or word.text.isdigit():
                result.loose += self.items("", 0)
            elif word.text == ";":
                self.at += 1
            else:
                self.entry(self.known, 0)
        return result

    def entry(self, values: dict[str, list[Item]], depth: int) -> None:
        """Read ``name items;`` or ``name { ... }``."""
        name = self.word()
        if name.text in "(){}[];":
            raise bad_file(f"line {name.line}: {name.text!r} where the name of an entry is expected")
        if self.peek() == "{":
            values[name.text] = [self.item(depth)]
            return
        values[name.text] = self.items(";", depth)
        if self.at >= len(self.words):
            raise bad_file(f"line {name.line}: the entry {name.text[:30]!r} does not end with ';'")
        self.at += 1

    def items(self, end: str, depth: int) -> list[Item]:
        """The items up to ``end``, or up to the end of the file."""
        found: list[Item] = []
        while self.at < len(self.words) and self.peek() != end:
            if self.peek().startswith("$"):
                found += self.variable(self.word(), depth)
            else:
                found.append(self.item(depth))
            if not end and isinstance(found[-1], Items):
                break
        return found

    def item(self, depth: int) -> Item:
        word = self.word()
        if depth >= MAX_DEPTH:
            raise bad_file(f"line {word.line}: more than {MAX_DEPTH} lists inside each other")
        if word.text == "(":
            return Items(self.closed(")", word, depth), word.line)
        if word.text == "[":
            return Items(self.closed("]", word, depth), word.line)
        if word.text == "{":
            values: dict[str, list[Item]] = {}
            while self.peek() != "}":
                self.entry(values, depth + 1)
            self.at += 1
            return Entries(values, word.line)
        if word.text in (")", "]", "}", ";"):
            raise bad_file(f"line {word.line}: {word.text!r} is not expected here")
        return word

    def closed(self, end: str, start: Word, depth: int) -> list[Item]:
        found = self.items(end, depth + 1)
        if self.at >= len(self.words):
            raise bad_file(f"line {start.line}: this {start.text!r} is not closed")
        self.at += 1
        return found

    def variable(self, word: Word, depth: int) -> list[Item]:
        match = _VARIABLE.fullmatch(word.text)
        name = (match[1] or match[2]) if match else ""
        if name not in self.known:
            raise bad_file(
                f"line {word.line}: the variable {word.text[:40]!r} is no entry above it in this file: write its value,"
                " or mesh with blockMesh and read constant/polyMesh"
            )
        found = self.known[name]
        if depth + max(map(_depth, found), default=0) > MAX_DEPTH:
            raise bad_file(f"line {word.line}: more than {MAX_DEPTH} lists inside each other")
        self.taken += sum(map(_size, found))
        if self.taken > MAX_WORDS:
            raise bad_file(f"line {word.line}: variables bring more than {MAX_WORDS} words")
        return found

    def word(self) -> Word:
        self.peek()
        self.at += 1
        return self.words[self.at - 1]

    def peek(self) -> str:
        if self.at >= len(self.words):
            raise bad_file(f"line {self.lines}: the file ends inside an entry")
        return self.words[self.at].text


def _words(text: str) -> Iterator[Word]:
    line, before = 1, 0
    for match in _TOKEN.finditer(text):
        line, before = line + text.count("\n", before, match.start()), match.start()
        found = match[0]
        if found.startswith(("//", "/*")):
            continue
        if found.startswith("#"):
            raise bad_file(
                f"line {line}: {found[:30]!r} needs OpenFOAM: write its result, or mesh with blockMesh and read"
                " constant/polyMesh"
            )
        yield Word(found, line)


def _size(item: Item) -> int:
    """The words and lists of an item, in all."""
    return 1 + sum(map(_size, _inner(item)))


def _depth(item: Item) -> int:
    """How many lists of an item are inside each other."""
    return 0 if isinstance(item, Word) else 1 + max(map(_depth, _inner(item)), default=0)


def _inner(item: Item) -> Sequence[Item]:
    if isinstance(item, Word):
        return ()
    return item.items if isinstance(item, Items) else [one for found in item.values.values() for one in found]


def as_word(item: Item) -> Word:
    """The item as a word; raises :class:`~equimesh.errors.InputError` with the line for a list."""
    if not isinstance(item, Word):
        raise bad_file(f"line {item.line}: one word or number is expected, not a list")
    return item


def as_items(item: Item) -> Items:
    """The item as a list in ( ); raises :class:`~equimesh.errors.InputError` with the line for others."""
    if not isinstance(item, Items):
        raise bad_file(f"line {item.line}: a list in ( ) is expected, not {text_of(item)[:30]!r}")
    return item


def numbers_of(item: Item, count: int) -> list[float]:
    """A list of ``count`` finite numbers; raises :class:`~equimesh.errors.InputError` with the line for others."""
    found = [as_word(word).number() for word in as_items(item).items]
    if len(found) != count or not all(map(math.isfinite, found)):
        raise bad_file(f"line {item.line}: {count} numbers in ( ) are needed")
    return found


def text_of(item: Item) -> str:
    """The text of a word, and what stands for it in messages for a list."""
    return item.text if isinstance(item, Word) else "( )"


def list_of(entries: Dictionary, name: str, *, needed: bool = True) -> Sequence[Item]:
    """The items of an entry that is one list; empty where there is none and it is not ``needed``."""
    found = entries.values.get(name, [])
    if len(found) == 1 and isinstance(found[0], Items):
        return found[0].items
    if found or needed:
        where = f"line {found[0].line}: " if found else ""
        raise bad_file(f"{where}the blockMeshDict needs a list {name} ( ... );")
    return []


def one_word(items: Sequence[Item], name: str) -> Word:
    """The value of the entry ``name`` that is one word."""
    if len(items) != 1 or not isinstance(items[0], Word):
        where = f"line {items[0].line}: " if items else ""
        raise bad_file(f"{where}{name} needs one value")
    return items[0]


# The files of a mesh that are needed; ``neighbour`` says nothing more.
FILES: Final = ("points", "faces", "owner", "boundary")
# Points of a face, at most, where not all faces have four.
MAX_CORNERS: Final = 100
# The other two coordinates of a plane across x, y or z.
ACROSS: Final = {0: (1, 2), 1: (0, 2), 2: (0, 1)}

_HEAD = re.compile(rb"FoamFile\s*\{[^{}]*\}")
_COMMENT = re.compile(rb"//[^\n]*|/\*.*?(?:\*/|\Z)", re.DOTALL)
_PUNCTUATION: Final = bytes.maketrans(b"()", b"  ")


def read_poly_mesh(files: Mapping[str, bytes]) -> PlainMesh:
    """The plane mesh of the files ``points``, ``faces``, ``owner`` and ``boundary``, by name.

    The mesh must be one layer of hexahedra between two planes across x, y or z. The points of the lower plane become
    the nodes, in their order; cells keep their numbers, patches become sides, without their faces in the planes. Raises
    :class:`~equimesh.errors.InputError` for other meshes, for binary files, and for broken ones, with the line.

    Source: OpenFOAM user guide, "Mesh description".
    """
    for name in FILES:
        if name not in files:
            raise bad_file(f"the polyMesh has no file {name!r}: it needs {', '.join(FILES)}")
    points = _vectors(files["points"])
    owner = _list(files["owner"], "owner")
    faces = _faces(files["faces"])
    if len(owner) != len(faces):
        raise bad_file(f"polyMesh: {len(owner)} owners of {len(faces)} faces")
    if faces.max(initial=-1) >= len(points) or owner.min(initial=0) < 0:
        raise bad_file("polyMesh: a face has a point, or an owner, that there is not")
    axis, upper = _layer(points)
    count_upper = np.where(faces >= 0, upper[np.maximum(faces, 0)], False).sum(axis=1)
    corners = (faces >= 0).sum(axis=1)
    below = np.flatnonzero(count_upper == 0)
    other = below[corners[below] != 4]
    if len(other):
        nodes = faces[other[0]]
        raise refuse_cell(_polygon(int(corners[other[0]])), int(owner[other[0]]), points, nodes[nodes >= 0])
    cells = np.full((int(owner.max(initial=-1)) + 1, 4), -1)
    cells[owner[below]] = faces[below][:, 3::-1]
    if len(below) != len(cells) or (cells < 0).any():
        raise bad_file(
            f"polyMesh: {len(cells)} cells have {len(below)} faces in the lower plane: one layer has one each"
        )
    walls = (count_upper == 2) & (corners == 4)
    astray = ~walls & (count_upper != 0) & (count_upper != corners)
    if astray.any():
        cell = int(owner[astray.argmax()])
        raise bad_file(f"polyMesh: cell {cell} does not go straight from plane to plane")
    sides = {}
    for name, first, count in _patches(files["boundary"], len(faces)):
        own = np.arange(first, first + count)
        own = own[walls[own]]  # the others are in the planes
        if len(own):
            sides[name] = _lower_edges(faces[own, :4], upper)
    return PlainMesh.of(np.ascontiguousarray(points[:, ACROSS[axis]]), cells, sides)


def _layer(points: Array) -> tuple[int, IntArray]:
    """The axis across the layer, and whether each point is in the upper plane."""
    size = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    for axis in (2, 1, 0):
        values = points[:, axis]
        if not len(values):
            break
        low, high = values.min(), values.max()
        upper = values > 0.5 * (low + high)
        apart = np.where(upper, high - values, values - low)
        if high > low and 2 * upper.sum() == len(values) and apart.max() <= PLANE * size:
            return axis, upper.astype(np.int64)
    raise bad_file(
        "polyMesh: the points do not lie in two planes across x, y or z: only one layer of cells between two planes"
        " can be adapted (extrudeMesh makes one)"
    )


def _lower_edges(faces: IntArray, upper: IntArray) -> IntArray:
    """The edge of each face in the lower plane, in the direction in which the face goes around."""
    start = ((upper[faces] == 0) & (upper[np.roll(faces, -1, axis=1)] == 0)).argmax(axis=1)
    rows = np.arange(len(faces))
    return np.column_stack([faces[rows, start], faces[rows, (start + 1) % 4]])


def _body(data: bytes, name: str) -> tuple[bytes, int]:
    """The text of a list after its head, and its first line."""
    head = _HEAD.search(data)
    if head is not None and re.search(rb"format\s+binary", head[0]):
        raise bad_file(f"polyMesh: the file {name!r} is binary: convert it with foamFormatConvert to ascii")
    start = head.end() if head is not None else 0
    return _COMMENT.sub(lambda found: b"\n" * found[0].count(b"\n"), data[start:]), line_of(data, start)


def _list(data: bytes, name: str) -> IntArray:
    """The integers of a list, without their number in front."""
    text, line = _body(data, name)
    flat = integers(text.translate(_PUNCTUATION), line, f"the file {name!r}")
    if not len(flat) or flat[0] != len(flat) - 1:
        raise bad_file(f"polyMesh: the list in {name!r} does not have the length that it tells")
    return flat[1:]


def _vectors(data: bytes) -> Array:
    text, line = _body(data, "points")
    flat = floats(text.translate(_PUNCTUATION), line, "the file 'points'")
    if not len(flat) or 3 * flat[0] != len(flat) - 1:
        raise bad_file("polyMesh: the list in 'points' does not have the length that it tells")
    return flat[1:].reshape(-1, 3)


def _faces(data: bytes) -> IntArray:
    """The points of every face, shape ``(f, c)``, filled with -1 where a face has fewer than ``c``."""
    text, line = _body(data, "faces")
    flat = integers(text.translate(_PUNCTUATION), line, "the file 'faces'")
    count = int(flat[0]) if len(flat) else 0
    if len(flat) == 1 + 5 * count and (flat[1::5] == 4).all():
        faces = flat[1:].reshape(count, 5)[:, 1:]
    else:
        starts, at = [], 1
        while at < len(flat) and flat[at] > 2:
            starts.append(at)
            at += 1 + int(flat[at])
        if len(starts) != count or at != len(flat):
            raise bad_file("polyMesh: the list in 'faces' does not have the length that it tells")
        first = np.array(starts, dtype=np.int64)
        most = int(flat[first].max(initial=4))
        if most > MAX_CORNERS:
            raise bad_file(f"polyMesh: a face has {most} points: {MAX_CORNERS} are possible")
        column = np.arange(most)
        inside = column < flat[first][:, None]
        faces = np.where(inside, flat[np.minimum(first[:, None] + 1 + column, len(flat) - 1)], -1)
        if (faces[inside] < 0).any():
            raise bad_file("polyMesh: a face has a negative point")
        return faces
    if faces.min(initial=0) < 0:
        raise bad_file("polyMesh: a face has a negative point")
    return faces


def _patches(data: bytes, faces: int) -> list[tuple[str, int, int]]:
    """The name, the first face and the number of faces of each patch."""
    found = []
    lists = [item for item in parse(data.decode("latin-1")).loose if isinstance(item, Items)]
    items = list(lists[0].items) if lists else []
    for name, entries in zip(items[::2], items[1::2], strict=False):
        if not (isinstance(name, Word) and isinstance(entries, Entries)):
            raise bad_file("polyMesh: the file 'boundary' is no list of patches")
        numbers = []
        for key in ("startFace", "nFaces"):
            value = entries.values.get(key, [])
            if len(value) != 1 or not isinstance(value[0], Word):
                raise bad_file(f"line {name.line} of 'boundary': the patch {name.text!r} has no {key}")
            numbers.append(value[0].integer())
        first, count = numbers
        if first < 0 or count < 0 or first + count > faces:
            raise bad_file(f"line {name.line} of 'boundary': the patch {name.text!r} has faces that there are not")
        found.append((name.text.strip('"'), first, count))
    if sum(count for _, _, count in found) > faces:
        raise bad_file("polyMesh: the patches in 'boundary' overlap: each face has one patch")
    return found


def _polygon(corners: int) -> str:
    return "triangle" if corners == 3 else f"polygon of {corners} corners"
