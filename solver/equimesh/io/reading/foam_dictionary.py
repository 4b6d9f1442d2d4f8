"""OpenFOAM's dictionaries, their literal subset: entries, lists and numbers, without code and calculations."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Final, TypeAlias

from equimesh.errors import InputError

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
            raise InputError(f"line {self.line}: {self.text[:30]!r} is no number", field="file") from None

    def integer(self) -> int:
        """The word as an integer; raises :class:`~equimesh.errors.InputError` with the line."""
        try:
            return int(self.text)
        except ValueError:
            raise InputError(f"line {self.line}: {self.text[:30]!r} is no integer", field="file") from None


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
            raise InputError(f"line {self.words[-1].line}: the file has more than {MAX_WORDS} words", field="file")
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
            raise InputError(f"line {name.line}: {name.text!r} where the name of an entry is expected", field="file")
        if self.peek() == "{":
            values[name.text] = [self.item(depth)]
            return
        values[name.text] = self.items(";", depth)
        if self.at >= len(self.words):
            raise InputError(f"line {name.line}: the entry {name.text[:30]!r} does not end with ';'", field="file")
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
            raise InputError(f"line {word.line}: more than {MAX_DEPTH} lists inside each other", field="file")
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
            raise InputError(f"line {word.line}: {word.text!r} is not expected here", field="file")
        return word

    def closed(self, end: str, start: Word, depth: int) -> list[Item]:
        found = self.items(end, depth + 1)
        if self.at >= len(self.words):
            raise InputError(f"line {start.line}: this {start.text!r} is not closed", field="file")
        self.at += 1
        return found

    def variable(self, word: Word, depth: int) -> list[Item]:
        match = _VARIABLE.fullmatch(word.text)
        name = (match[1] or match[2]) if match else ""
        if name not in self.known:
            message = (
                f"line {word.line}: the variable {word.text[:40]!r} is no entry above it in this file: write its value,"
                " or mesh with blockMesh and read constant/polyMesh"
            )
            raise InputError(message, field="file")
        found = self.known[name]
        if depth + max(map(_depth, found), default=0) > MAX_DEPTH:
            raise InputError(f"line {word.line}: more than {MAX_DEPTH} lists inside each other", field="file")
        self.taken += sum(map(_size, found))
        if self.taken > MAX_WORDS:
            raise InputError(f"line {word.line}: variables bring more than {MAX_WORDS} words", field="file")
        return found

    def word(self) -> Word:
        self.peek()
        self.at += 1
        return self.words[self.at - 1]

    def peek(self) -> str:
        if self.at >= len(self.words):
            raise InputError(f"line {self.lines}: the file ends inside an entry", field="file")
        return self.words[self.at].text


def _words(text: str) -> Iterator[Word]:
    line, before = 1, 0
    for match in _TOKEN.finditer(text):
        line, before = line + text.count("\n", before, match.start()), match.start()
        found = match[0]
        if found.startswith(("//", "/*")):
            continue
        if found.startswith("#"):
            message = (
                f"line {line}: {found[:30]!r} needs OpenFOAM: write its result, or mesh with blockMesh and read"
                " constant/polyMesh"
            )
            raise InputError(message, field="file")
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
        raise InputError(f"line {item.line}: one word or number is expected, not a list", field="file")
    return item


def as_items(item: Item) -> Items:
    """The item as a list in ( ); raises :class:`~equimesh.errors.InputError` with the line for others."""
    if not isinstance(item, Items):
        raise InputError(f"line {item.line}: a list in ( ) is expected, not {text_of(item)[:30]!r}", field="file")
    return item


def numbers_of(item: Item, count: int) -> list[float]:
    """A list of ``count`` finite numbers; raises :class:`~equimesh.errors.InputError` with the line for others."""
    found = [as_word(word).number() for word in as_items(item).items]
    if len(found) != count or not all(map(math.isfinite, found)):
        raise InputError(f"line {item.line}: {count} numbers in ( ) are needed", field="file")
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
        raise InputError(f"{where}the blockMeshDict needs a list {name} ( ... );", field="file")
    return []


def one_word(items: Sequence[Item], name: str) -> Word:
    """The value of the entry ``name`` that is one word."""
    if len(items) != 1 or not isinstance(items[0], Word):
        where = f"line {items[0].line}: " if items else ""
        raise InputError(f"{where}{name} needs one value", field="file")
    return items[0]
