"""The report as a PDF, for paper."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
from fpdf import FPDF
from fpdf.enums import TableBordersLayout
from fpdf.fonts import FontFace

from valor.analysis import report
from valor.analysis.chapters import Chapter, command_for_all
from valor.analysis.errors import ResultError
from valor.analysis.report import Grid
from valor.analysis.results import Picture
from valor.analysis.style import GREY, INK, LIGHT

MARGIN = 18.0  # [mm]
BODY, SMALL = 9.5, 7.5  # type sizes [pt]
FAILED = "#b55a52"  # what is not there
_FONT = "DejaVu"
_FONTS = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
_MEASURE_WIDTHS = (30, 9, 12, 17, 32)  # shares of the width
_SUMMARY_WIDTHS = (50, 14, 10, 26)
_HEAD = FontFace(emphasis="", color=GREY)


class _Pages(FPDF):  # type: ignore[misc]  # untyped
    """A4, with the page's number below."""

    def __init__(self) -> None:
        super().__init__(format="A4")
        for style, name in (("", "DejaVuSans"), ("B", "DejaVuSans-Bold")):
            self.add_font(_FONT, style, _FONTS / f"{name}.ttf")
        self.set_margin(MARGIN)
        self.set_auto_page_break(True, MARGIN)
        self.set_title(report.TITLE)
        self.set_draw_color(LIGHT)

    def footer(self) -> None:
        self.set_y(-12.0)
        self.word(str(self.page_no()), SMALL, GREY, align="R")

    def word(self, text: str, size: float, color: str = INK, style: str = "", align: str = "L") -> None:
        """A paragraph."""
        self.set_font(_FONT, style, size)
        self.set_text_color(color)
        self.multi_cell(0.0, 0.5 * size, text, align=align, new_x="LMARGIN", new_y="NEXT")

    def cells(self, grid: Grid, widths: Sequence[float]) -> None:
        """A table with lines between its rows."""
        self.set_font(_FONT, "", SMALL)
        self.set_text_color(INK)
        alignment = ["RIGHT" if i in grid.right else "LEFT" for i in range(len(grid.head))]
        with self.table(
            borders_layout=TableBordersLayout.HORIZONTAL_LINES, line_height=0.52 * SMALL, padding=(0.7, 1.2),
            col_widths=tuple(widths), text_align=tuple(alignment), headings_style=_HEAD,
        ) as table:  # fmt: skip
            for cells in (grid.head, *grid.rows):
                table.row(cells)
        self.ln(3.0)


def write(chapters: Sequence[Chapter], file: Path) -> Path:
    """Write the PDF; returns its path.

    Raises:
        ResultError: a picture is broken inside.
    """
    pages = _Pages()
    pages.add_page()
    pages.word(report.TITLE, 20.0, style="B")
    pages.ln(2.0)
    pages.word(report.INTRODUCTION, BODY)
    pages.ln(2.0)
    if command := command_for_all(chapters):
        pages.word(f"{report.ALL_AGAIN} {command}", SMALL, GREY)
    summary = report.summary(chapter.result for chapter in chapters)
    if summary.rows:
        pages.ln(3.0)
        pages.cells(summary, _SUMMARY_WIDTHS)
    for i, chapter in enumerate(chapters):
        if i or summary.rows:
            pages.add_page()
        _section(pages, chapter)
    file.parent.mkdir(parents=True, exist_ok=True)
    pages.output(str(file))
    return file


def _section(pages: _Pages, chapter: Chapter) -> None:
    pages.ln(5.0)
    pages.start_section(chapter.title)
    pages.word(chapter.title, 14.0, style="B")
    result = chapter.result
    if result is None:
        pages.word(chapter.reproduces, SMALL, GREY)
        pages.ln(1.5)
        pages.word(chapter.absence, BODY, FAILED)
        return
    pages.word(report.about(result), SMALL, GREY)
    pages.ln(1.5)
    if result.quick:
        pages.word(report.SHORT, BODY, style="B")
        pages.ln(1.5)
    pages.word(result.text, BODY)
    pages.ln(2.0)
    if result.measures:
        pages.cells(report.grid_of_measures(result.measures), _MEASURE_WIDTHS)
    for table in result.tables:
        pages.word(table.title, BODY, style="B")
        pages.ln(1.0)
        _table(pages, report.grid_of_table(table))
    for picture in result.pictures:
        _picture(pages, picture, chapter)
    pages.word(f"{report.AGAIN} {result.command}", SMALL, GREY)


def _table(pages: _Pages, grid: Grid) -> None:
    longest = [max(len(row[i]) for row in (grid.head, *grid.rows)) for i in range(len(grid.head))]
    pages.cells(grid, [min(max(length, 8), 30) for length in longest])


def _picture(pages: _Pages, picture: Picture, chapter: Chapter) -> None:
    if fault := chapter.fault(picture):
        pages.word(report.not_shown(picture, fault), BODY, FAILED)
        pages.ln(3.0)
        return
    try:
        with pages.unbreakable() as block:
            block.image(str(chapter.folder / picture.file), w=block.epw)
            block.word(report.caption(picture), SMALL, GREY)
            block.ln(3.0)
    except OSError as error:
        reason = error.strerror or "not a picture"
        raise ResultError(f"{chapter.folder / picture.file}: {reason}; the result names it as a picture") from None
