"""What a notebook shows of an object: a sentence, a table, warnings and a picture, as HTML."""

import base64
import html
from collections.abc import Iterable

MAX_WARNINGS = 3
"""Warnings below the table."""


def html_of(
    title: str,
    facts: Iterable[tuple[str, str]],
    warnings: Iterable[str] = (),
    picture: bytes | None = None,
    alternative: str = "the mesh, coloured by its error",
) -> str:
    """A ``picture``, a PNG, beside a ``title`` and a table of ``facts``, each with its name; in the notebook's colours.

    Of the ``warnings`` the first few are told. ``alternative`` is the text for those who do not see the picture. The
    words are short; with a picture of at most 70 kB the text stays below 100 kB.
    """
    rows = "".join(
        f'<tr><th style="text-align:left">{_text(name)}</th><td style="text-align:left">{_text(fact)}</td></tr>'
        for name, fact in facts
    )
    several = list(warnings)
    told = [_text(one) for one in several[:MAX_WARNINGS]]
    if len(several) > MAX_WARNINGS:
        told.append(f"{len(several) - MAX_WARNINGS} more warnings are in the certificate.")
    remarks = "".join(f'<p style="max-width:60ch;margin:0.4em 0 0 0">{one}</p>' for one in told)
    words = f"<strong>{_text(title)}</strong><table>{rows}</table>{remarks}"
    image = ""
    if picture is not None:
        source = base64.b64encode(picture).decode()
        image = f'<img alt="{html.escape(alternative)}" style="max-width:20em" src="data:image/png;base64,{source}">'
    return (
        '<div style="display:flex;flex-wrap:wrap;gap:1.5em;align-items:flex-start">'
        f'{image}<div style="flex:1 1 20em;min-width:0">{words}</div></div>'
    )


def _text(words: str) -> str:
    return html.escape(words, quote=False)
