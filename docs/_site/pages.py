"""A hook of MkDocs: formulas become MathML, which needs no script; long names in tables may be broken."""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

MARKED = re.compile(  # by arithmatex
    r'<(?P<tag>span|div) class="arithmatex">(?:\\\((?P<inline>.+?)\\\)|\\\[(?P<block>.+?)\\\])</(?P=tag)>', re.DOTALL
)
CELL, LONG_NAME = re.compile(r"<td.*?</td>", re.DOTALL), re.compile(r"<code>[^<]{24,}</code>")


def on_page_content(content: str, **_: Any) -> str:
    """Rewrite a page's HTML."""
    return CELL.sub(_with_breaks, MARKED.sub(_mathml, content))


def _mathml(found: re.Match[str]) -> str:
    inline, block = found["inline"], found["block"]
    return convert(html.unescape(inline or block).strip(), display="inline" if inline else "block")


def _with_breaks(cell: re.Match[str]) -> str:
    return LONG_NAME.sub(lambda name: re.sub(r"(?<!<)([/_])", r"\1<wbr>", name[0]), cell[0])
