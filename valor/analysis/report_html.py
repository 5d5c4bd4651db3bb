"""The report as a page that needs no other file."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from pathlib import Path

from valor.analysis import report
from valor.analysis.chapters import Chapter, command_for_all
from valor.analysis.report import Grid
from valor.analysis.results import Picture

_STYLE = """
:root { color-scheme: light; --ink: #22272e; --grey: #6b7480; --line: #dde1e6; --soft: #f5f7f9; --accent: #0072b2; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 62rem; padding: 2.5rem 1.5rem 5rem; color: var(--ink); background: white;
       font: 16px/1.55 "DejaVu Sans", "Segoe UI", Roboto, Helvetica, Arial, sans-serif; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .4rem; }
h2 { font-size: 1.35rem; margin: 3.2rem 0 .2rem; padding-top: 1.4rem; border-top: 2px solid var(--line); }
h3 { font-size: 1rem; margin: 1.8rem 0 .4rem; }
p { margin: .5rem 0 .9rem; max-width: 46rem; }
.quiet { color: var(--grey); font-size: .87rem; }
nav { margin: 1.4rem 0; padding: .9rem 1.2rem; background: var(--soft); border-radius: .4rem; }
nav a { display: block; color: var(--accent); text-decoration: none; padding: .12rem 0; }
nav a:hover { text-decoration: underline; }
table { border-collapse: collapse; width: 100%; margin: .6rem 0 1rem; font-size: .9rem; }
th { text-align: left; color: var(--grey); font-weight: normal; border-bottom: 1px solid var(--line); }
th, td { padding: .32rem .7rem .32rem 0; vertical-align: top; }
td { border-bottom: 1px solid var(--soft); }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.measures td:nth-child(1) { width: 27%; } .measures td:nth-child(2) { font-weight: bold; }
.measures td:nth-child(3) { white-space: nowrap; } .measures td:nth-child(4) { width: 17%; }
.measures td:nth-child(5) { width: 34%; color: var(--grey); }
figure { margin: 1.4rem 0; }
figure img { width: 100%; height: auto; border: 1px solid var(--line); border-radius: .3rem; }
figcaption { color: var(--grey); font-size: .87rem; margin-top: .3rem; }
code { background: var(--soft); padding: .1rem .35rem; border-radius: .25rem; font-size: .88em; }
.failed { background: #fbe9e7; border-left: 4px solid #b55a52; padding: .5rem .9rem; margin: .8rem 0; }
.warning { background: #fdf3df; border-left: 4px solid #e69f00; padding: .5rem .9rem; margin: .8rem 0; }
@media print { body { max-width: none; padding: 0; } h2 { break-before: page; border: 0; }
               figure, table { break-inside: avoid; } }
.summary td:nth-child(2) { font-weight: bold; }
@media (max-width: 40rem) {
  body { padding: 1.2rem .9rem 3rem; } h1 { font-size: 1.5rem; } code { overflow-wrap: anywhere; }
  table { display: block; overflow-x: auto; font-size: .82rem; }
  .measures, .measures tr { display: block; } .measures tr:first-child { display: none; }
  .measures td, .measures td.number { display: inline; width: auto; padding: 0 .4rem 0 0; border: 0; }
  .measures tr { padding: .5rem 0; border-bottom: 1px solid var(--line); }
  .measures td:nth-child(4)::before { content: "thesis: "; } .measures td:nth-child(5) { display: block; }
  figure { overflow-x: auto; } figure img { width: max(100%, 40rem); }
}
"""


def write(chapters: Sequence[Chapter], file: Path) -> Path:
    """Write the page; returns its path."""
    links = "".join(
        f'<a href="#{_text(chapter.name)}">{_text(chapter.title)} '
        f'<span class="quiet">{_text(chapter.reproduces)}{"" if chapter.result else " · no result"}</span></a>'
        for chapter in chapters
    )
    command = command_for_all(chapters)
    again = f'<p class="quiet">{report.ALL_AGAIN} <code>{_text(command)}</code>.</p>' if command else ""
    summary = report.summary(chapter.result for chapter in chapters)
    short = _grid(summary, "summary") if summary.rows else ""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(
        "<!doctype html>\n"
        '<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{report.TITLE}</title><style>{_STYLE}</style></head><body>"
        f"<h1>{report.TITLE}</h1><p>{report.INTRODUCTION}</p>"
        f"{short}<nav>{links}</nav>{again}{''.join(_section(chapter) for chapter in chapters)}</body></html>\n"
    )
    return file


def _section(chapter: Chapter) -> str:
    head = f'<h2 id="{_text(chapter.name)}">{_text(chapter.title)}</h2>'
    result = chapter.result
    if result is None:
        return f'{head}<p class="quiet">{_text(chapter.reproduces)}</p><p class="failed">{_text(chapter.absence)}</p>'
    measures = _grid(report.grid_of_measures(result.measures), "measures") if result.measures else ""
    quick = f'<p class="warning">{report.SHORT}</p>' if result.quick else ""
    files = f" Data beside it: {', '.join(_text(file) for file in result.files)}." if result.files else ""
    return (
        f'{head}<p class="quiet">{_text(report.about(result))}</p>'
        f"{quick}<p>{_text(result.text)}</p>{measures}"
        f"{''.join(f'<h3>{_text(each.title)}</h3>{_grid(report.grid_of_table(each))}' for each in result.tables)}"
        f"{''.join(_picture(picture, chapter) for picture in result.pictures)}"
        f'<p class="quiet">{report.AGAIN} <code>{_text(result.command)}</code>.{files}</p>'
    )


def _grid(grid: Grid, kind: str = "rows") -> str:
    def row(tag: str, cells: Sequence[str]) -> str:
        kinds = (' class="number"' if i in grid.right else "" for i in range(len(cells)))
        inside = (f"<{tag}{kind}>{_text(cell)}</{tag}>" for kind, cell in zip(kinds, cells, strict=True))
        return f"<tr>{''.join(inside)}</tr>"

    rows = "".join(row("td", cells) for cells in grid.rows)
    return f'<table class="{kind}">{row("th", grid.head)}{rows}</table>'


def _picture(picture: Picture, chapter: Chapter) -> str:
    if fault := chapter.fault(picture):
        return f'<p class="failed">{_text(report.not_shown(picture, fault))}</p>'
    data = base64.b64encode((chapter.folder / picture.file).read_bytes()).decode()
    return (
        f'<figure><img alt="{_text(picture.caption)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{_text(report.caption(picture))}</figcaption></figure>"
    )


def _text(value: str) -> str:
    return html.escape(value)
