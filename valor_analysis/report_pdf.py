"""The report as a PDF: the same results as on the page, for paper."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
from fpdf import FPDF
from fpdf.enums import TableBordersLayout
from fpdf.fonts import FontFace

from valor_analysis.chapters import INTRODUCTION, SHORT, TITLE, Chapter, command_for_all
from valor_analysis.errors import ResultError
from valor_analysis.report import MEASURES, about, number
from valor_analysis.results import Measure, Picture, Table
from valor_analysis.style import GREY, INK, LIGHT

MARGIN = 18.0  # [mm]
BODY, SMALL = 9.5, 7.5  # type sizes [pt]
FAILED = "#b55a52"  # what is not there
_FONT = "DejaVu"
_FONTS = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
_HEAD = FontFace(emphasis="", color=GREY)


class _Pages(FPDF):  # type: ignore[misc]  # untyped
    """A4, with the page's number below."""

    def __init__(self) -> None:
        super().__init__(format="A4")
        for style, name in (("", "DejaVuSans"), ("B", "DejaVuSans-Bold")):
            self.add_font(_FONT, style, _FONTS / f"{name}.ttf")
        self.set_margin(MARGIN)
        self.set_auto_page_break(True, MARGIN)
        self.set_title(TITLE)
        self.set_draw_color(LIGHT)

    def footer(self) -> None:
        self.set_y(-12.0)
        self.word(str(self.page_no()), SMALL, GREY, align="R")

    def word(self, text: str, size: float, color: str = INK, style: str = "", align: str = "L") -> None:
        """A paragraph."""
        self.set_font(_FONT, style, size)
        self.set_text_color(color)
        self.multi_cell(0.0, 0.5 * size, text, align=align, new_x="LMARGIN", new_y="NEXT")

    def rows(
        self, head: Sequence[str], rows: Sequence[Sequence[str]], widths: Sequence[float], right: set[int]
    ) -> None:
        """A table with lines between its rows."""
        self.set_font(_FONT, "", SMALL)
        self.set_text_color(INK)
        alignment = ["RIGHT" if i in right else "LEFT" for i in range(len(head))]
        with self.table(
            borders_layout=TableBordersLayout.HORIZONTAL_LINES, line_height=0.52 * SMALL, padding=(0.7, 1.2),
            col_widths=tuple(widths), text_align=tuple(alignment), headings_style=_HEAD,
        ) as table:  # fmt: skip
            for cells in (head, *rows):
                table.row(cells)
        self.ln(3.0)


def write(chapters: Sequence[Chapter], file: Path) -> Path:
    """Write the PDF; returns its path.

    Raises:
        ResultError: a picture is broken inside.
    """
    pages = _Pages()
    pages.add_page()
    pages.word(TITLE, 20.0, style="B")
    pages.ln(2.0)
    pages.word(INTRODUCTION, BODY)
    pages.ln(2.0)
    if command := command_for_all(chapters):
        pages.word(f"All of it again: {command}", SMALL, GREY)
    for i, chapter in enumerate(chapters):
        if i:
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
    pages.word(about(result), SMALL, GREY)
    pages.ln(1.5)
    if result.quick:
        pages.word(SHORT, BODY, style="B")
        pages.ln(1.5)
    pages.word(result.text, BODY)
    pages.ln(2.0)
    _measures(pages, result.measures)
    for table in result.tables:
        _table(pages, table)
    for picture in result.pictures:
        _picture(pages, picture, chapter)
    pages.word(f"Made again by: {result.command}", SMALL, GREY)


def _measures(pages: _Pages, measures: Sequence[Measure]) -> None:
    if measures:
        rows = [(one.name, number(one.value), one.unit, one.thesis or "–", one.note) for one in measures]
        pages.rows(MEASURES, rows, (30, 9, 12, 17, 32), {1})


def _table(pages: _Pages, table: Table) -> None:
    pages.word(table.title, BODY, style="B")
    pages.ln(1.0)
    longest = [max(len(row[i]) for row in (table.columns, *table.rows)) for i in range(len(table.columns))]
    widths = [min(max(length, 8), 30) for length in longest]
    pages.rows(table.columns, table.rows, widths, {i for i in range(len(table.columns)) if not table.is_text(i)})


def _picture(pages: _Pages, picture: Picture, chapter: Chapter) -> None:
    if fault := chapter.fault(picture):
        pages.word(f"{picture.caption} Not shown: {fault}.", BODY, FAILED)
        pages.ln(3.0)
        return
    where = f" Reproduces {picture.reproduces}." if picture.reproduces else ""
    try:
        with pages.unbreakable() as block:
            block.image(str(chapter.folder / picture.file), w=block.epw)
            block.word(f"{picture.caption}{where}", SMALL, GREY)
            block.ln(3.0)
    except OSError as error:
        reason = error.strerror or "not a picture"
        raise ResultError(f"{chapter.folder / picture.file}: {reason}; the result names it as a picture") from None
