"""The settings of a document, one by one: what a command line, or a page, has to know to offer them."""

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from equimesh_schema.document import Document, Shown, Words, docs_of, key_of, one_of, types_of
from equimesh_schema.monitors import MEMBERS, MONITORS
from equimesh_schema.schwarz import TRANSMISSIONS
from equimesh_schema.sources import functions_of


@dataclass(frozen=True, kw_only=True)
class Setting:
    """A field that holds a number, a flag or a word. ``plain`` is None for words alone."""

    key: str
    plain: type[Any] | None
    words: tuple[str, ...]
    takes_null: bool
    default: Any
    help: str
    shown: Shown

    def to_json(self) -> dict[str, Any]:
        """The setting as it is published."""
        titles = self.shown.words
        words = [{"name": word, "title": titles.get(word, word.replace("_", " "))} for word in self.words]
        nothing = [{"name": None, "title": titles.get("", "none")}] if self.takes_null else []
        kinds = {float: "number", int: "integer", bool: "flag", None: "word"}
        return {
            "name": self.key,
            "type": kinds[self.plain],
            "default": None if self.default is MISSING else self.default,
            "help": self.help,
            "words": [*nothing, *words],
            "title": self.key.replace("_", " ").capitalize(),
            **self.shown.json,
        }


def setting_of(document: type[Document], name: str) -> Setting | None:
    """The setting that a field is; None for functions, documents and lists."""
    (field,) = (one for one in fields(document) if one.name == name)  # type: ignore[arg-type]
    annotation = types_of(document)[name]
    if one_of(annotation) is not None:
        return None
    parts, marks = [annotation], [*getattr(annotation, "__metadata__", ())]
    for one in parts:
        parts += [part for part in get_args(one) if get_origin(one) is not Literal and part not in marks]
        marks += getattr(one, "__metadata__", ())
    if any(get_origin(one) not in (None, Literal, Annotated, Union, UnionType) for one in parts):
        return None
    literals = [word for one in parts if get_origin(one) is Literal for word in get_args(one)]
    listed = next((mark for mark in marks if isinstance(mark, Words)), None)
    plain = next((one for one in (bool, float, int) if one in parts), None)
    words = tuple(listed or literals)
    if plain is None and not words:
        return None
    return Setting(
        key=key_of(document, name),
        plain=plain,
        words=words,
        takes_null=type(None) in parts,
        default=field.default,
        help=docs_of(document).get(name, ""),
        shown=next((mark for mark in marks if isinstance(mark, Shown)), Shown()),
    )


def settings_of(document: type[Document]) -> list[Setting]:
    """The settings of a document, in their order, without its kind."""
    found = [setting_of(document, one.name) for one in fields(document) if one.name != "kind"]  # type: ignore[arg-type]
    return [one for one in found if one is not None]


def choices() -> Mapping[str, Any]:
    """The kinds of monitors and of transmission conditions with their settings, as a service publishes them."""
    return {
        "monitors": [
            {
                **_kind(name, document),
                "title": document.TITLE or name.replace("_", " ").capitalize(),
                "functions": list(functions_of(document)),
                "member": name in MEMBERS.documents,
            }
            for name, document in MONITORS.documents.items()
        ],
        "transmissions": [_kind(name, document) for name, document in TRANSMISSIONS.documents.items()],
    }


def _kind(name: str, document: Any) -> dict[str, Any]:
    settings = [one.to_json() for one in settings_of(document)]
    return {"name": name, "when_to_use": document.USE, "settings": settings}
