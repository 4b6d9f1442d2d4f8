"""Log lines, as text or as one JSON object a line, in the service and in its workers."""

import logging
import traceback
from datetime import UTC, datetime
from types import TracebackType
from typing import Any

from pythonjsonlogger.json import JsonFormatter
from sqlalchemy.exc import SQLAlchemyError

from equimesh_service.telemetry.log_context import current

_TEXT = "%(asctime)s %(levelname)s %(name)s: %(message)s"
_ACCESS = logging.getLogger("equimesh_service.access")
# Libraries that log much about themselves.
_VERBOSE = ("numba", "matplotlib", "PIL", "asyncio", "urllib3", "httpcore", "httpx", "multipart", "python_multipart")
_MAX_FRAMES = 12

_Raised = tuple[type[BaseException], BaseException, TracebackType | None] | tuple[None, None, None]


def configure(level: str, format: str) -> None:
    """Write the log of this process to standard error, from ``level`` up, as ``"text"`` or ``"json"``.

    Does nothing when handlers exist: a program that runs a service decides about its own log.
    """
    root = logging.getLogger()
    if root.handlers:
        return
    handler = logging.StreamHandler()
    handler.setFormatter(formatter(format))
    logging.basicConfig(level=level.upper(), handlers=[handler])
    for name in _VERBOSE:
        logging.getLogger(name).setLevel(max(logging.WARNING, root.level))


def formatter(format: str) -> logging.Formatter:
    """The formatter of log lines."""
    return _Json() if format == "json" else _Text(_TEXT)


def access(method: str, route: str, status: int, seconds: float, size: int) -> None:
    """Log an answered request; ``route`` is the template of the path, which holds no input of a client."""
    if _ACCESS.isEnabledFor(logging.INFO):
        fields = {"method": method, "route": route, "status": status, "duration": round(seconds, 6), "bytes": size}
        _ACCESS.info("%s %s %d, %.1f ms, %d bytes", method, route, status, 1e3 * seconds, size, extra=fields)


def describe_error(error: BaseException) -> str:
    """An exception in one line: its type, and where it was raised.

    Its message is added only for errors of the system and the database: other messages may quote input of a client.
    """
    words = str(error).partition("\n")[0][:300] if isinstance(error, OSError | SQLAlchemyError) else ""
    frames = traceback.extract_tb(error.__traceback__)[-_MAX_FRAMES:]
    places = [f"{_short(frame.filename)}:{frame.lineno} {frame.name}" for frame in reversed(frames)]
    cause = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    shown = ": ".join(filter(None, (type(error).__name__, words)))
    where = f" at {' < '.join(places)}" if places else ""
    return f"{shown}{where}" + (f"; because of {describe_error(cause)}" if cause is not None else "")


def _short(filename: str) -> str:
    return "/".join(filename.replace("\\", "/").split("/")[-2:])


def _describe_raised(raised: _Raised) -> str:
    return "" if raised[1] is None else describe_error(raised[1])


class _Text(logging.Formatter):
    """A line of text, with the log context at its end."""

    def format(self, record: logging.LogRecord) -> str:
        record.exc_text = None  # the text of another handler
        return super().format(record)

    def formatMessage(self, record: logging.LogRecord) -> str:
        known = " ".join(f"{name}={value}" for name, value in current().to_fields().items())
        line = super().formatMessage(record)
        return f"{line} [{known}]" if known else line

    def formatException(self, ei: _Raised) -> str:
        return _describe_raised(ei)


class _Json(JsonFormatter):
    """A JSON object: time, level, logger, message, the log context, and further fields of the record."""

    def format(self, record: logging.LogRecord) -> str:
        record.exc_text = None
        return super().format(record)

    def add_fields(self, log_data: dict[str, Any], record: logging.LogRecord, message_dict: dict[str, Any]) -> None:
        log_data["time"] = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="microseconds")[:-6] + "Z"
        log_data["level"] = record.levelname.lower()
        log_data["logger"] = record.name
        log_data["message"] = record.getMessage()
        log_data.update(current().to_fields())
        super().add_fields(log_data, record, {})
        if "exc_info" in message_dict:
            log_data["exception"] = message_dict["exc_info"]

    def formatException(self, ei: _Raised) -> str:
        return _describe_raised(ei)
