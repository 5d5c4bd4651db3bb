"""A hook of MkDocs: the formulas that arithmatex has marked become MathML, which browsers draw without a script."""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

MARKED = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">(?:\\\((?P<inline>.+?)\\\)|\\\[(?P<block>.+?)\\\])</(?P=tag)>', re.DOTALL
)


def _mathml(found: re.Match[str]) -> str:
    inline, block = found["inline"], found["block"]
    return convert(html.unescape(inline or block).strip(), display="inline" if inline else "block")


def on_page_content(content: str, **_: Any) -> str:
    """Replace each formula of a page (LaTeX, between arithmatex' marks)."""
    return MARKED.sub(_mathml, content)
