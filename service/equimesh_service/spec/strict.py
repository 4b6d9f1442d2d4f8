"""Strict models of JSON bodies, and the complaints about a body that does not fit one."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Self, TypeVar, get_args, get_origin

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    ModelWrapValidatorHandler,
    Tag,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from equimesh_schema import document
from equimesh_schema.document import TAG, Document
from equimesh_service.problems.problem import Complaint, input_problem
from equimesh_service.problems.sentences import did_you_mean, sentence_of
from equimesh_service.spec.document import escape_token

# The most complaints about one body.
MAX_COMPLAINTS = 20
# The type of the error for what is not looked at any more.
_ENOUGH = "enough"
Model = TypeVar("Model")
Validated = TypeVar("Validated", bound=BaseModel)


@dataclass
class Faults:
    """The number of faults that were found in a document so far."""

    number: int = 0

    def read(self, model: type[Any], value: Any, handler: Callable[[Any], Model]) -> Model:
        """The object, read no further when :data:`MAX_COMPLAINTS` faults were found: each costs memory and time."""
        left = MAX_COMPLAINTS - self.number
        if left <= 0:
            raise PydanticCustomError(_ENOUGH, "not looked at")
        if isinstance(value, Mapping):
            unknown = [key for key in value if key not in keys_of(model)]
            if len(unknown) > left:
                extra = set(unknown[left:])
                value = {key: member for key, member in value.items() if key not in extra}
        before = self.number
        try:
            return handler(value)
        except ValidationError as error:
            self.number = before + error.error_count()
            raise


class Strict(BaseModel):
    """A JSON object without further keys, whose values have exactly the types of the model."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)
    REFUSED: ClassVar[Mapping[str, str]] = {}
    """The sentences that refuse keys of other models, by these keys."""
    MISSING: ClassVar[Mapping[str, str]] = {}
    """The sentences for keys that are required and absent."""

    @model_validator(mode="wrap")
    @classmethod
    def _stop_after_enough(cls, value: Any, handler: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:
        return info.context.read(cls, value, handler) if isinstance(info.context, Faults) else handler(value)


def keys_of(model: type[Any]) -> tuple[str, ...]:
    """The keys of the JSON objects of a model."""
    if issubclass(model, Document):
        return document.keys_of(model)
    return tuple(field.alias or name for name, field in model.model_fields.items())


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


def validate(model: type[Validated], body: Any) -> Validated:
    """The model of a parsed JSON document; raises a 422 problem that lists what is wrong, with pointers."""
    if not isinstance(body, Mapping):
        raise input_problem([Complaint(pointer="", message="the body must be one JSON object")])
    try:
        return model.model_validate(body, context=Faults())
    except ValidationError as error:
        found = error.errors(include_url=False, include_context=True)
        entries = [entry for entry in found if entry["type"] != _ENOUGH]
        raise input_problem([_complaint(model, entry) for entry in entries[:MAX_COMPLAINTS]]) from None


def _complaint(model: type[BaseModel], entry: Any) -> Complaint:
    loc = list(entry["loc"])
    place = [part for part in loc if not _is_tag(part)]
    if entry["type"] == "kind" and isinstance(entry["input"], Mapping):
        place.append("kind")
    return Complaint(pointer="".join(map(escape_token, place)), message=_sentence(model, entry, loc))


def _sentence(model: type[BaseModel], entry: Any, loc: list[Any]) -> str:
    match entry["type"]:
        case "missing" | "extra_forbidden" | "unexpected_keyword_argument" as fault:
            return _sentence_of_key(_model_at(model, loc[:-1]), loc[-1], missing=fault == "missing")
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


def _sentence_of_key(place: type[Any] | None, key: Any, *, missing: bool) -> str:
    """What is wrong with a key of the model at a ``place``, None where there is no single model."""
    if place is not None and issubclass(place, Strict | Document):
        told = (place.MISSING if missing else place.REFUSED).get(key)
        if told is not None:
            return told
    if missing:
        return "this key is required"
    known = () if place is None else keys_of(place)
    return "there is no such key here" + (f"; known are {', '.join(known)}" if known else "") + did_you_mean(key, known)


def _model_at(model: type[BaseModel], loc: Sequence[Any]) -> type[Any] | None:
    """The model at ``loc``; None when there is no single one."""
    found: Any = model
    for part in loc:
        models = _models(found)
        if _is_tag(part):
            found = next((branch for tag, branch in models if tag == part), None)
        elif isinstance(part, str):
            found = _annotations(models[0][1]).get(part) if len(models) == 1 else None
    models = _models(found)
    return models[0][1] if len(models) == 1 else None


def _annotations(model: type[Any]) -> dict[str, Any]:
    """The types of the values of a model, by their keys."""
    if issubclass(model, Document):
        return {document.key_of(model, name): kind for name, kind in document.types_of(model).items()}
    return {
        field.alias or name: Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
        for name, field in model.model_fields.items()
    }


def _models(annotation: Any, tag: str | None = None) -> list[tuple[str | None, type[Any]]]:
    """The models of a type, with their tags."""
    if get_origin(annotation) is None:
        is_model = isinstance(annotation, type) and issubclass(annotation, BaseModel | Document)
        return [(tag, annotation)] if is_model else []
    metadata = getattr(annotation, "__metadata__", None)
    mark = next((part for part in metadata or () if isinstance(part, document.OneOf)), None)
    if mark is not None:
        return [(TAG + name, branch) for name, branch in mark.documents.items()]
    inner = get_args(annotation) if metadata is None else get_args(annotation)[:1]
    tag = next((part.tag for part in metadata or () if isinstance(part, Tag)), tag)
    return [found for part in inner for found in _models(part, tag)]
