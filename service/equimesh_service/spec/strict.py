"""Strict models of JSON bodies, and the complaints about a body that does not fit one."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, TypeVar, get_args, get_origin

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    FailFast,
    Field,
    FiniteFloat,
    Tag,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)
from pydantic_core import PydanticCustomError

from equimesh_service.problems.problem import Complaint, input_problem
from equimesh_service.spec.document import escape_token

# The first character of tags of unions, so that they can be removed from a pointer.
TAG = "\x00"
# The most complaints about one body.
MAX_COMPLAINTS = 20
# The pattern of texts that databases store: PostgreSQL refuses U+0000.
WITHOUT_NUL = r"^[^\x00]*$"
Model = TypeVar("Model", bound=BaseModel)

Numbers = Annotated[list[FiniteFloat], FailFast()]
Pair = Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]
Parameters = Annotated[dict[str, FiniteFloat], Field(max_length=64)]


class Strict(BaseModel):
    """A JSON object without further keys, whose values have exactly the types of the model."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
    REFUSED: ClassVar[Mapping[str, str]] = {}
    """The sentences that refuse keys of other models, by these keys."""
    MISSING: ClassVar[Mapping[str, str]] = {}
    """The sentences for keys that are required and absent."""


def by_key(*keys: str) -> Discriminator:
    """A union whose branch is the one of the key that is present."""

    def tag(value: Any) -> str | None:
        if isinstance(value, Mapping):
            return next((TAG + key for key in keys if key in value), None)
        return next((TAG + key for key in keys if hasattr(value, key)), None)

    message = f"this must be an object with one of the keys {', '.join(keys)}"
    return Discriminator(tag, custom_error_type="source", custom_error_message=message)


def by_kind(*kinds: str, default: str | None = None) -> Discriminator:
    """A union whose branch is named by the key ``kind``."""

    def tag(value: Any) -> str | None:
        kind = value.get("kind", default) if isinstance(value, Mapping) else getattr(value, "kind", None)
        return TAG + kind if isinstance(kind, str) and kind in kinds else None

    message = f"an object whose kind is one of {', '.join(kinds)}"
    return Discriminator(tag, custom_error_type="kind", custom_error_message=message)


def either(words: str) -> WrapValidator:
    """One sentence for a union of plain values, in place of a complaint of each of its branches."""

    def validate(value: Any, inner: ValidatorFunctionWrapHandler) -> Any:
        try:
            return inner(value)
        except ValidationError:
            raise PydanticCustomError("either", "this must be {words}", {"words": words}) from None

    return WrapValidator(validate)


def validate(model: type[Model], document: Any) -> Model:
    """The model of a parsed JSON document; raises a 422 problem that lists what is wrong, with pointers."""
    if not isinstance(document, Mapping):
        raise input_problem([Complaint(pointer="", message="the body must be one JSON object")])
    try:
        return model.model_validate(document)
    except ValidationError as error:
        entries = error.errors(include_url=False, include_context=True)
        raise input_problem([_complaint(model, entry) for entry in entries[:MAX_COMPLAINTS]]) from None


def _complaint(model: type[BaseModel], entry: Any) -> Complaint:
    loc = list(entry["loc"])
    place = [part for part in loc if not _is_tag(part)]
    if entry["type"] == "kind" and isinstance(entry["input"], Mapping):
        place.append("kind")
    return Complaint(pointer="".join(map(escape_token, place)), message=_sentence(model, entry, loc))


def _sentence(model: type[BaseModel], entry: Any, loc: list[Any]) -> str:
    match entry["type"]:
        case "missing" | "extra_forbidden" as fault:
            return _sentence_of_key(_model_at(model, loc[:-1]), loc[-1], missing=fault == "missing")
        case "finite_number":
            return "this must be a finite number, not NaN or infinity"
        case "model_type" | "model_attributes_type" | "dict_type":
            return "this must be a JSON object"
        case "too_short" | "too_long" if entry["ctx"]["field_type"] == "List":
            most = entry["ctx"].get("max_length", 2)
            return f"this must be a list of {'2' if most == 2 else f'at most {most}'} items"
        case "string_pattern_mismatch" if entry["ctx"]["pattern"] == WITHOUT_NUL:
            return "this text must not hold the character U+0000"
        case "literal_error":
            return f"this must be {entry['ctx']['expected']}"
        case "kind" if isinstance(entry["input"], Mapping):
            return str(entry["msg"]).replace("an object whose kind is one of", "this key must be one of")
        case "kind":
            return f"this must be {entry['msg']}"
        case _:
            message = str(entry["msg"]).removeprefix("Input ")
            return f"this {message}" if message.startswith("should") else message


def _is_tag(part: object) -> bool:
    return isinstance(part, str) and part.startswith(TAG)


def _sentence_of_key(place: type[BaseModel] | None, key: Any, *, missing: bool) -> str:
    """What is wrong with a key of the model at a ``place``, None where there is no single model."""
    if place is not None and issubclass(place, Strict):
        told = (place.MISSING if missing else place.REFUSED).get(key)
        if told is not None:
            return told
    if missing:
        return "this key is required"
    return "there is no such key here" + ("" if place is None else f"; known are {', '.join(place.model_fields)}")


def _model_at(model: type[BaseModel], loc: Sequence[Any]) -> type[BaseModel] | None:
    """The model at ``loc``; None when there is no single one."""
    found: Any = model
    for part in loc:
        models = _models(found)
        if _is_tag(part):
            found = next((branch for tag, branch in models if tag == part), None)
        elif isinstance(part, str):
            field = models[0][1].model_fields.get(part) if len(models) == 1 else None
            found = field.annotation if field is not None else None
    models = _models(found)
    return models[0][1] if len(models) == 1 else None


def _models(annotation: Any, tag: str | None = None) -> list[tuple[str | None, type[BaseModel]]]:
    """The models of a type, with their tags."""
    if get_origin(annotation) is None:
        is_model = isinstance(annotation, type) and issubclass(annotation, BaseModel)
        return [(tag, annotation)] if is_model else []
    metadata = getattr(annotation, "__metadata__", None)
    inner = get_args(annotation) if metadata is None else get_args(annotation)[:1]
    tag = next((part.tag for part in metadata or () if isinstance(part, Tag)), tag)
    return [found for part in inner for found in _models(part, tag)]
