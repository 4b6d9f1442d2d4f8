"""Repairs of the pages that Sphinx and the theme write, for keyboards and screen readers."""

from __future__ import annotations

import re

# The lines of a signature are no list of definitions.
_SIGNATURE = re.compile(r'<dl>\n((?:<dd><em class="sig-param">.*?</dd>\n)+)</dl>', re.DOTALL)
_TEXTS = {
    # Landmarks have names.
    '<aside class="sidebar-drawer">': '<aside class="sidebar-drawer" aria-label="Site">',
    '<aside class="toc-drawer': '<aside aria-label="Page" class="toc-drawer',
    # The caption of a part of the menu is no heading of the page.
    '<p class="caption" role="heading">': '<p class="caption">',
    # What scrolls is reached by the keyboard.
    "<pre>": '<pre tabindex="0">',
    '<div class="table-wrapper': '<div tabindex="0" class="table-wrapper',
    # A cell without a text is no heading.
    '<th class="head"><p></p></th>': '<td class="head"></td>',
    '<th class="head"></th>': '<td class="head"></td>',
}


def repaired(text: str) -> str:
    """The HTML of a page, with the repairs."""
    for old, new in _TEXTS.items():
        text = text.replace(old, new)
    return _SIGNATURE.sub(_lines, text)


def _lines(match: re.Match[str]) -> str:
    lines = match[1].replace("<dd>", '<span class="sig-line">').replace("</dd>", "</span>")
    return f'<span class="sig-lines">{lines}</span>'
