"""Turn numbers and names into short pieces of text, the same everywhere.

value ± standard error,    to the first digit of the error
"""

from __future__ import annotations

import math
import re
import textwrap
import unicodedata
from collections.abc import Sequence

LEAST_PERCENT = 5e-4  # probability: smaller values are written as powers of ten, not in per cent
MOST_DIGITS = 15  # significant digits: beyond, numbers differ by the rounding of float64
NUM_NAMES = 3  # names that are listed before the other names are only counted


def some_names(names: Sequence[str]) -> str:
    """Return the first names and how many more there are: 'demo_1, demo_2, demo_3 and 30 more'."""
    first = ", ".join(shown(name) for name in names[:NUM_NAMES])
    more = len(names) - NUM_NAMES
    return f"{first} and {more} more" if more > 0 else first


def times(nats: float) -> str:
    """Return e^nats to two digits; as a power of ten where e^nats is large or small."""
    if not -math.log(1e4) < nats <= math.log(1e9):
        return f"10^{nats / math.log(10):.0f}" if math.isfinite(nats) else "0"
    value = float(f"{math.exp(nats):.1e}")
    return f"{value:,.0f}" if value >= 10 else f"{value:g}"


def probability(value: float, error: float) -> str:
    """Return a probability with its standard error: '97.2 ± 0.4 %', or '2e-06' if tiny."""
    if value + error < LEAST_PERCENT:
        return f"{value:.0e}" if value > 0.0 else "0"
    if error < LEAST_PERCENT:
        return f"{100.0 * value:.3g} %"
    return f"{measured(100.0 * value, 100.0 * error)} %"


def measured(value: float, error: float) -> str:
    """Return a value to the first digit of its error: '13.4 ± 0.1'; '13.42' if the error is 0."""
    if error == 0.0:
        return f"{value:.2f}"
    digits = 4 if error < 1e-4 else max(0, -math.floor(math.log10(float(f"{error:.0e}"))))
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def told_apart(value: float, other: float, digits: int) -> tuple[str, str]:
    """Return two numbers as texts of so many digits, or of as many more as tell them apart.

    Numbers that agree in MOST_DIGITS digits have the same text, of so many digits.
    """
    for enough in range(digits, MOST_DIGITS + 1):
        texts = f"{value:.{enough}g}", f"{other:.{enough}g}"
        if texts[0] != texts[1]:
            return texts
    return f"{value:.{digits}g}", f"{other:.{digits}g}"


def counted(number: int, noun: str) -> str:
    """Return a number with its noun: '1 task' or '1,200 tasks'."""
    return f"{number:,} {noun if number == 1 else plural(noun)}"


def plural(noun: str) -> str:
    """Return the plural of a noun: 'tasks', 'hypotheses'."""
    return f"{noun[:-2]}es" if noun.endswith("is") else f"{noun}s"


def duration(seconds: float) -> str:
    """Return a length of time in one unit: '45 s', '12 min' or '3.5 h'."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    if seconds < 99.5 * 60.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"


def shown(text: str) -> str:
    r"""Return a text from outside as it may be printed: without control characters.

    Each character that a terminal would obey, that changes the direction or the order of what
    follows, or that cannot be seen, becomes its escape sequence, such as \x1b; so do line breaks.
    """
    if text.isprintable():
        return text
    return "".join(
        letter
        if letter.isprintable() or unicodedata.category(letter) == "Zs"
        else ascii(letter)[1:-1]
        for letter in text
    )


def shown_lines(text: str) -> str:
    """Return a text as it may be printed, with its line breaks."""
    return "\n".join(map(shown, text.split("\n")))


def cut(text: str, length: int) -> str:
    """Return text on one line of at most `length` characters, without control characters."""
    text = shown(" ".join(text.split()))
    return text if len(text) <= length else f"{text[: length - 1]}…"


def ended(text: str) -> str:
    """Return text with a full stop, unless it ends in a question mark or was cut."""
    return text if text.endswith(("?", "…")) else f"{text}."


def wrapped(text: str, width: float, size: float) -> str:
    """Wrap text of a font size [pt] to lines of a width [in], with no break inside a value."""
    text = shown(" ".join(text.split()))
    text = re.sub(r"(?<=,) (?=[^\s,]+\))| (?=±)|(?<=±) | (?=nats)", "\N{NO-BREAK SPACE}", text)
    return textwrap.fill(text, int(width * 72 / (0.6 * size)))
