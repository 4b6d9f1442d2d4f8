"""The pages of the command line and of the settings, from the parser of `equimesh` and the fields of the settings."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from equimesh_cli.command import build_parser
from equimesh_service.settings import Settings, groups, variable
from generator.schemas import escaped

COMMANDS = "reference/commands.md"
SETTINGS = "reference/variables.md"


def command_pages() -> dict[str, str]:
    """The Markdown of both pages by their names on the site."""
    return {COMMANDS: "\n".join(_commands()), SETTINGS: "\n".join(_settings())}


def _commands() -> Iterator[str]:
    yield "# Options of all commands\n"
    yield "Made from the parser, as `equimesh COMMAND --help` prints them. [What the commands are for](cli.md)."
    yield "Those of `serve`, `config` and `doctor` are the [settings](variables.md).\n"
    for name, parser in _below(build_parser()):
        yield f"## {name}\n\n{escaped(parser.description or '')}\n"
        yield from _options(parser)
        for action, below in _below(parser):
            yield f"### {name} {action}\n\n{escaped(below.description or '')}\n"
            yield from _options(below)


def _below(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """The commands below a parser, by their names."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            yield from action.choices.items()


def _options(parser: argparse.ArgumentParser) -> Iterator[str]:
    """The table of the options that a parser has itself; none where it has only the help."""
    formatter = parser._get_formatter()
    hidden = (argparse._SubParsersAction, argparse._HelpAction)
    shown = [action for action in parser._actions if not isinstance(action, hidden)]
    if not shown:
        return
    yield "| option | meaning |\n|---|---|"
    for action in shown:
        names = "`, `".join(action.option_strings) or str(action.metavar or action.dest)
        words = "" if action.choices is None else " `" + "`, `".join(map(str, action.choices)) + "`."
        meaning = formatter._expand_help(action) if action.help else ""
        yield f"| `{names}` | {escaped(meaning)}{words} |"
    yield ""


def _settings() -> Iterator[str]:
    yield "# All settings of the service\n"
    yield "Made from the settings. [How they are given](settings.md).\n"
    for title, names in groups().items():
        yield f"## {title.capitalize()}\n\n| variable | option | default | meaning |\n|---|---|---|---|"
        for name in names:
            field = Settings.model_fields[name]
            default = "one for each processor" if field.default_factory else _shown(field.default)
            option = f"--{name.replace('_', '-')}"
            row = (f"`{variable(name)}`", f"`{option}`", default, escaped(field.description or ""))
            yield f"| {' | '.join(row)} |"
        yield ""


def _shown(default: Any) -> str:
    """A default as it stands in a variable."""
    text = str(default).lower() if isinstance(default, bool) else str(default)
    return f"`{text.removesuffix('.0')}`" if text else "empty"
