"""Write the page, the tables and the pictures of the report as HTML.

Text is escaped here; `document` alone takes HTML.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape as escape_html

import numpy as np
from matplotlib.figure import Figure

from swerve.base.phrases import counted, shown_lines

DPI = 180  # pixels an inch: 8.4 in become 1,512 pixels, for the 62 rem that a page is wide

STYLE = """
:root { color-scheme: light dark; --ink: #1c1c1e; --faint: #5f6066; --paper: #fff;
  --line: #d9d9de; --band: #f4f4f6; --alarm: #8a2c00; --alarm-paper: #fff1e8; }
@media (prefers-color-scheme: dark) { :root { --ink: #ececf0; --faint: #a5a5ad; --paper: #17171a;
  --line: #3b3b42; --band: #212126; --alarm: #ffb38a; --alarm-paper: #3a2010; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 62rem; padding: 1.2rem 1rem 3rem; background: var(--paper);
  color: var(--ink); font: 1rem/1.55 system-ui, sans-serif; overflow-wrap: break-word;
  -webkit-text-size-adjust: 100%; }
h1 { font-size: 1.45rem; line-height: 1.35; margin: .3rem 0 .6rem; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .6rem; }
p, dd, li { max-width: 46rem; }
.faint, figcaption, footer { color: var(--faint); font-size: .9rem; }
.alarm { background: var(--alarm-paper); color: var(--alarm); border-left: .3rem solid var(--alarm);
  padding: .7rem 1rem; margin: 1rem 0; border-radius: .2rem; }
.alarm p { margin: .3rem 0; }
figure { margin: 1rem 0; }
figcaption { margin-top: .4rem; }
img { display: block; width: 100%; height: auto; background: #fff; border-radius: .3rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { padding: .3rem .7rem .3rem 0; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--line); }
th { color: var(--faint); font-weight: 600; vertical-align: bottom; }
td.name { min-width: 11rem; max-width: 30rem; overflow-wrap: anywhere; }
.number { text-align: right; }
td.number, td.vector { white-space: nowrap; }
td.verdict { min-width: 7rem; }
tr.first td { background: var(--band); font-weight: 600; }
tr.low td { color: var(--alarm); font-weight: 600; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .3rem 1.2rem; margin: 0; }
dt { color: var(--faint); }
dd { margin: 0; overflow-wrap: anywhere; }
@media (max-width: 700px) {
  dl { grid-template-columns: 1fr; gap: 0; } dd { margin-bottom: .5rem; } }
"""


def escape(text: str) -> str:
    """Return text as HTML: no part of it is a tag, and nothing in it changes how the page reads."""
    return escape_html(shown_lines(text))


def document(title: str, body: str) -> str:
    """Return a whole page, its style inside, from its title and the HTML of its body."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n{body}\n"
        "</body>\n</html>\n"
    )


def picture(wide: Figure, narrow: Figure, description: str, caption: str = "") -> str:
    """Return a picture in two layouts; the browser shows the one that fits the screen."""
    text = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return (
        f'<figure><picture><source media="(max-width: 700px)" srcset="{_data(narrow)}">'
        f'<img src="{_data(wide)}" alt="{escape(description)}"></picture>{text}</figure>'
    )


def _data(figure: Figure) -> str:
    """Return a figure as a PNG inside a data URL."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"


def table(
    head: Sequence[str], rows: Iterable[tuple[str, Sequence[str]]], columns: dict[int, str]
) -> str:
    """Return a table.

    Args:
      head: text above each column.
      rows: CSS class and cells of each row.
      columns: CSS class of each column that does not hold numbers, by its place from 0.
    """
    kinds = [columns.get(k, "number") for k in range(len(head))]
    lines = [_row("th", "", kinds, head), *(_row("td", kind, kinds, row) for kind, row in rows)]
    return f'<div class="scroll"><table>{"".join(lines)}</table></div>'


def _row(tag: str, kind: str, kinds: Sequence[str], cells: Sequence[str]) -> str:
    """Return a row of CSS class `kind`; `kinds` are the CSS classes of its cells."""
    pairs = zip(kinds, cells, strict=True)
    inside = "".join(f'<{tag} class="{k}">{escape(cell)}</{tag}>' for k, cell in pairs)
    return f'<tr class="{kind}">{inside}</tr>\n'


def more(number: int, noun: str, which: str = "") -> str:
    """Return a line that counts the rows left out of a table; nothing if there are none."""
    text = f"and {counted(number, f'more {noun}')}{which}."
    return f'<p class="faint">{escape(text)}</p>' if number > 0 else ""


def vector(values: np.ndarray) -> str:
    """Return a state or a goal as text, for a cell: '0.1, 3.14'."""
    return ", ".join(f"{value:.3g}" for value in values)
