"""The report's folder: ``README.md`` with its figures as WebP, and the same as one HTML file, which prints well.

The HTML is rendered from the Markdown; it contains the figures.
"""

from __future__ import annotations

import base64
import itertools
import re
from collections.abc import Sequence
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token
from PIL import Image

from thesis.errors import ResultError
from thesis.report.chapters import Chapter
from thesis.report.document import TITLE, markdown, picture_name
from valor.common import whole_file

MARKDOWN, HTML = "README.md", "report.html"
_STYLE = """
:root { color-scheme: light; }
body { margin: 0 auto; max-width: 62rem; padding: 2rem 1.5rem; color: #22272e; background: white;
       font: 16px/1.5 "DejaVu Sans", "Segoe UI", Roboto, Helvetica, Arial, sans-serif; }
h2 { margin-top: 3rem; padding-top: 1rem; border-top: 2px solid #dde1e6; }
p { max-width: 46rem; }
nav { padding: .9rem 1.2rem; background: #f5f7f9; }
nav a { display: block; color: #0072b2; text-decoration: none; }
table { border-collapse: collapse; width: 100%; font-size: .87rem; }
th { color: #6b7480; font-weight: normal; text-align: left; }
th, td { padding: .3rem .7rem .3rem 0; vertical-align: top; border-bottom: 1px solid #dde1e6; }
td[style] { font-variant-numeric: tabular-nums; white-space: nowrap; }
img { width: 100%; }
em { color: #6b7480; font-style: normal; font-size: .87rem; }
pre { background: #f5f7f9; padding: .5rem; white-space: pre-wrap; overflow-wrap: anywhere; }
@media (max-width: 40rem) { body { padding: 1rem .9rem; } table { display: block; overflow-x: auto; } }
@page { size: A4; margin: 16mm; }
@media print { body { max-width: none; padding: 0; font-size: 10pt; } nav { display: none; }
               h2 { break-before: page; border: 0; }
               tr, img, p { break-inside: avoid; } p:has(img) { break-after: avoid; } }
"""


def write(chapters: Sequence[Chapter], folder: Path) -> tuple[Path, Path]:
    """Write the report; returns the paths of page and Markdown.

    Raises:
        ResultError: a file cannot be written.
    """
    text = markdown(chapters)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for chapter in chapters:
            for picture in chapter.result.pictures if chapter.result else ():
                if picture.file not in chapter.faults:
                    with Image.open(chapter.folder / picture.file) as opened:
                        opened.convert("RGB").save(folder / picture_name(picture), lossless=True, method=6)
        whole_file.write(folder / MARKDOWN, text)
        whole_file.write(folder / HTML, _html(text, folder))
    except OSError as error:
        raise ResultError(f"{error.filename or folder}: {error.strerror or error}") from None
    return folder / HTML, folder / MARKDOWN


def _html(text: str, folder: Path) -> str:
    """The Markdown as one file, with anchors at its sections and pictures from a folder."""
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens = parser.parse(text)
    links = []
    for head, inline in itertools.pairwise(tokens):
        if head.type == "heading_open" and head.tag == "h2":
            anchor = re.sub(r"\W+", "-", inline.content.lower()).strip("-")
            head.attrSet("id", anchor)
            links.append(f'<a href="#{anchor}">{parser.renderInline(inline.content)}</a>')
        for child in inline.children or ():
            if child.type == "image":
                _embed(child, folder)
    body = parser.renderer.render(tokens, parser.options, {})
    end = body.index("</h1>") + len("</h1>")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{TITLE}</title><style>{_STYLE}</style></head><body>\n"
        f"{body[:end]}\n<nav>{''.join(links)}</nav>{body[end:]}</body></html>\n"
    )


def _embed(image: Token, folder: Path) -> None:
    """Put a picture's content in the place of its path."""
    content = (folder / str(image.attrGet("src"))).read_bytes()
    image.attrSet("src", f"data:image/webp;base64,{base64.b64encode(content).decode()}")
