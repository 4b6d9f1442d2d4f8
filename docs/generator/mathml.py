"""A Sphinx extension that writes formulas as MathML, which browsers draw without a script."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

_logger = logging.getLogger(__name__)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer ``mathml``."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _markup(node: nodes.Element, *, is_block: bool) -> str:
    """The formula as MathML, or its text and a warning where its LaTeX is not known."""
    try:
        return str(tex2mathml(node.astext(), as_block=is_block))
    except MathError as error:
        _logger.warning("a formula could not be converted: %s", error, location=node)
        return f"<code>{node.astext()}</code>"


def _inline(writer: Any, node: nodes.math) -> None:
    writer.body.append(_markup(node, is_block=False))
    raise nodes.SkipNode


def _block(writer: Any, node: nodes.math_block) -> None:
    # A wide formula scrolls by itself, also with the keyboard.
    writer.body.append(f'<div class="formula" tabindex="0">{_markup(node, is_block=True)}</div>')
    raise nodes.SkipNode
