"""A Sphinx extension that moves scripts and styles out of pages into files, as the policy of the service demands."""

from __future__ import annotations

import re
from hashlib import sha256
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from generator.repairs import repaired

_SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)
_STYLE = re.compile(r"<style>(.*?)</style>", re.DOTALL)
_TAG = re.compile(r"<[a-z][\w-]*\s[^<>]*?\bstyle=\"[^\"]*\"[^<>]*>", re.IGNORECASE)
_ATTRIBUTE = re.compile(r"\s*\bstyle=\"([^\"]*)\"")
_CLASS = re.compile(r"\bclass=\"([^\"]*)\"")
# What is relative to the page: addresses, and the way to the front page for scripts.
_ADDRESS = re.compile(r"(\b(?:href|src|action|data-content_root)=\")(?![a-z]+:|#)([^\"]*)")
# Links to a service on the reader's machine lead to the service that serves the site.
_SERVICE = 'href="http://127.0.0.1:8000/'
# The file with the declarations of all attributes `style`.
_SHEET = "declarations.css"
_LINK = '<link rel="stylesheet" href="{root}_static/{name}">'


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the work on the finished pages."""
    app.connect("build-finished", _finish)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _finish(app: Sphinx, error: Exception | None) -> None:
    if error is None and app.builder.name == "html":
        move_inline(Path(app.outdir))


def move_inline(folder: Path) -> None:
    """Rewrite every page of the folder; what was inline is in ``_static`` afterwards."""
    declarations: dict[str, str] = {}
    for page in folder.rglob("*.html"):
        root = "../" * len(page.relative_to(folder).parent.parts)
        text = repaired(page.read_text(encoding="utf-8")).replace(_SERVICE, f'href="{root}../')
        text = _moved(text, root, folder / "_static", declarations)
        page.write_text(_anywhere(text) if page == folder / "404.html" else text, encoding="utf-8")
    rules = [f".{name} {{ {rule} }}\n" for rule, name in sorted(declarations.items())]
    (folder / "_static" / _SHEET).write_text("".join(rules), encoding="utf-8")


def _moved(text: str, root: str, static: Path, declarations: dict[str, str]) -> str:
    def script(match: re.Match[str]) -> str:
        return f'<script src="{root}_static/{_written(static, match[1], ".js")}"></script>'

    def style(match: re.Match[str]) -> str:
        return _LINK.format(root=root, name=_written(static, match[1], ".css"))

    def tag(match: re.Match[str]) -> str:
        found = _ATTRIBUTE.search(match[0])
        assert found is not None
        rule = found[1].rstrip("; ")
        name = declarations.setdefault(rule, f"declared-{_digest(rule)}")
        rest = _ATTRIBUTE.sub("", match[0], count=1)
        if _CLASS.search(rest):
            return _CLASS.sub(lambda old: f'class="{old[1]} {name}"', rest, count=1)
        return re.sub(r"^(<[a-z][\w-]*)", rf'\1 class="{name}"', rest, flags=re.IGNORECASE)

    text = _TAG.sub(tag, _STYLE.sub(style, _SCRIPT.sub(script, text)))
    return text.replace("</head>", _LINK.format(root=root, name=_SHEET) + "</head>", 1)


def _anywhere(text: str) -> str:
    """The page for addresses that lead nowhere: the service puts the way to the front page in front of its links."""
    return _ADDRESS.sub(r"\1{{root}}\2", text)


def _written(static: Path, content: str, suffix: str) -> str:
    """The name of the file with this content; pages with the same content share one."""
    name = f"moved-{_digest(content)}{suffix}"
    (static / name).write_text(content.strip() + "\n", encoding="utf-8")
    return name


def _digest(text: str) -> str:
    return sha256(text.encode()).hexdigest()[:12]
