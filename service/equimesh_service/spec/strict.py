"""Documents of requests, read with pydantic, and the complaints about a body that does not fit one."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar, get_args, get_origin

from pydantic import TypeAdapter, ValidationError
from pydantic_core import PydanticCustomError

from equimesh_schema.document import TAG, Document, OneOf, key_of, keys_of, types_of
from equimesh_service.problems.problem import Complaint, did_you_mean, input_problem, sentence_of
from equimesh_service.spec.document import escape_token

# The most complaints about one body.
MAX_COMPLAINTS = 20
# The type of the error for what is not looked at any more.
_ENOUGH = "enough"
T = TypeVar("T")


@lru_cache
def _adapter(document: Any) -> TypeAdapter[Any]:
    return TypeAdapter(document)


def to_json(document: Document) -> dict[str, Any]:
    """The JSON of a document that was read, with every default."""
    found: dict[str, Any] = _adapter(type(document)).dump_python(  # type: ignore[arg-type]
        document,
        mode="json",
        by_alias=True,
        warnings="none",  # pairs of defaults are tuples
    )
    return found


@dataclass
class Faults:
    """The number of faults that were found in a document so far."""

    number: int = 0

    def read(self, document: type[Document], value: Any, handler: Callable[[Any], T]) -> T:
        """The object, read no further when :data:`MAX_COMPLAINTS` faults were found: each costs memory and time."""
        left = MAX_COMPLAINTS - self.number
        if left <= 0:
            raise PydanticCustomError(_ENOUGH, "not looked at")
        if isinstance(value, Mapping):
            unknown = [key for key in value if key not in keys_of(document)]
            if len(unknown) > left:
                extra = set(unknown[left:])
                value = {key: member for key, member in value.items() if key not in extra}
        before = self.number
        try:
            return handler(value)
        except ValidationError as error:
            self.number = before + error.error_count()
            raise


def validate(document: type[T], body: Any) -> T:
    """The document of parsed JSON; raises a 422 problem that lists what is wrong, with pointers."""
    if not isinstance(body, Mapping):
        raise input_problem([Complaint(pointer="", message="the body must be one JSON object")])
    try:
        found: T = _adapter(document).validate_python(body, context=Faults())  # type: ignore[arg-type]
        return found
    except ValidationError as error:
        every = error.errors(include_url=False, include_context=True)
        entries = [entry for entry in every if entry["type"] != _ENOUGH]
        raise input_problem([_complaint(document, entry) for entry in entries[:MAX_COMPLAINTS]]) from None


def _complaint(document: type[Any], entry: Any) -> Complaint:
    loc = list(entry["loc"])
    place = [part for part in loc if not _is_tag(part)]
    if entry["type"] == "kind" and isinstance(entry["input"], Mapping):
        place.append("kind")
    return Complaint(pointer="".join(map(escape_token, place)), message=_sentence(document, entry, loc))


def _sentence(document: type[Any], entry: Any, loc: list[Any]) -> str:
    match entry["type"]:
        case "missing" | "extra_forbidden" | "unexpected_keyword_argument" as fault:
            return _sentence_of_key(_document_at(document, loc[:-1]), loc[-1], missing=fault == "missing")
        case "kind" if isinstance(entry["input"], Mapping):
            sentence = str(entry["msg"]).replace("an object whose kind is one of", "this key must be one of")
            return sentence + did_you_mean(entry["input"].get("kind"), sentence.partition(" one of ")[2].split(", "))
        case "kind":
            return f"this must be {entry['msg']}"
        case "source":
            given = entry["input"] if isinstance(entry["input"], Mapping) else {}
            known = str(entry["msg"]).partition(" keys ")[2].split(", ")
            return str(entry["msg"]) + next(filter(None, (did_you_mean(key, known) for key in given)), "")
        case "either":
            return str(entry["msg"])
        case _:
            return sentence_of(entry) or "this does not fit here"


def _is_tag(part: object) -> bool:
    return isinstance(part, str) and part.startswith(TAG)


def _sentence_of_key(place: type[Document] | None, key: Any, *, missing: bool) -> str:
    """What is wrong with a key of the document at a ``place``, None where there is no single one."""
    if place is not None:
        told = (place.MISSING if missing else place.REFUSED).get(key)
        if told is not None:
            return told
    if missing:
        return "this key is required"
    known = () if place is None else keys_of(place)
    return "there is no such key here" + (f"; known are {', '.join(known)}" if known else "") + did_you_mean(key, known)


def _document_at(document: type[Document], loc: Sequence[Any]) -> type[Document] | None:
    """The document at ``loc``; None when there is no single one."""
    found: Any = document
    for part in loc:
        documents = _documents(found)
        if _is_tag(part):
            found = next((branch for tag, branch in documents if tag == part), None)
        elif isinstance(part, str):
            only = documents[0][1] if len(documents) == 1 else None
            kinds = {} if only is None else {key_of(only, name): kind for name, kind in types_of(only).items()}
            found = kinds.get(part)
    documents = _documents(found)
    return documents[0][1] if len(documents) == 1 else None


def _documents(annotation: Any) -> list[tuple[str | None, type[Document]]]:
    """The documents of a type, with their tags."""
    if get_origin(annotation) is None:
        is_document = isinstance(annotation, type) and issubclass(annotation, Document)
        return [(None, annotation)] if is_document else []
    marks = getattr(annotation, "__metadata__", ())
    mark = next((part for part in marks if isinstance(part, OneOf)), None)
    if mark is not None:
        return [(TAG + name, branch) for name, branch in mark.documents.items()]
    return [
        found for part in (get_args(annotation)[:1] if marks else get_args(annotation)) for found in _documents(part)
    ]
