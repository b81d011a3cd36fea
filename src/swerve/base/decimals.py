"""Read numbers from texts by one grammar, the same wherever a text holds a number.

    number = [+-] (digits [. [digits]] | . digits) [(e|E) [+-] digits],   digits = 0 ... 9

Python's `float` accepts more, such as 2_5 for 25 and digits of other scripts.
"""

from __future__ import annotations

import math
import re
from decimal import Decimal

DECIMAL = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")


def decimal_number(text: str) -> float:
    """Return the number that a text holds, to the nearest float.

    Raises:
      ValueError: if the text is anything else than a number, spaces included, or the number is too
        large for a float.
    """
    if not DECIMAL.fullmatch(text):
        raise ValueError(f"expected a decimal number, got {text!r}")
    number = float(text)
    if math.isinf(number):
        raise ValueError(f"expected a number that a float can hold, got {text!r}")
    return number


def whole_decimal(text: str) -> int:
    """Return the whole number that a text holds, which may be written as 2e6.

    Raises:
      ValueError: if the text is anything else, or the number is too large for a float.
    """
    if not decimal_number(text).is_integer():
        raise ValueError(f"expected a whole number, got {text!r}")
    return int(Decimal(text))
