"""Plain lines of G-code to columns of numbers, in a compiled loop.

Plain lines have only an optional N, one of G0 to G3, and letters with numbers. All other lines are
*rare* and left to ``words.py``. Each number (up to 15 digits) becomes the nearest double.
"""

import numpy as np
from numpy.typing import NDArray

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import njit

#: Kinds of lines: without effect, plain, and those for the general reader.
EMPTY, PLAIN, RARE = 0, 1, 2
#: Letters of the columns of a plain line.
COLUMNS = 'XYZABCIJKRF'
X, Y, Z, A, B, C, I, J, K, R, F = range(11)
NO_CODE = -1  #: Code of a line without G0 to G3.

_MOST_DIGITS = 15
_POWERS = 10.0 ** np.arange(_MOST_DIGITS + 1)
_MOTION, _NUMBER, _NOTHING = 11, 12, 13
_LETTERS = np.full(256, _NOTHING, dtype=np.int64)
for _letter, _meaning in [*zip(COLUMNS, range(11), strict=True), ('G', _MOTION), ('N', _NUMBER)]:
    _LETTERS[ord(_letter)] = _LETTERS[ord(_letter.lower())] = _meaning


@njit(cache=True, nogil=True)
def scan_lines(
    text: NDArray[np.uint8],
    first: IntArray,
    last: IntArray,
    kind: NDArray[np.int8],
    code: NDArray[np.int8],
    values: FloatArray,
) -> int:
    """Scan lines that end with a newline; return their number.

    ``first``, ``last`` (m,): offsets of the first character and the newline; ``values`` (m, 11):
    numbers of plain lines in mm, deg or mm/min, NaN for missing words.
    """
    at, line, size = 0, 0, len(text)
    while at < size:
        first[line] = at
        kind[line], code[line] = EMPTY, NO_CODE
        for column in range(11):
            values[line, column] = np.nan
        while True:
            letter = text[at]
            if letter == 10:
                break
            if letter == 32 or letter == 9 or letter == 13:
                at += 1
                continue
            if letter == 59:  # ; begins a comment to the end of the line
                while text[at] != 10:
                    at += 1
                break
            if letter == 40:  # ( begins a comment in parentheses
                at, comma = at + 1, False
                while text[at] == 32:
                    at += 1
                begins = text[at] & 95  # in upper case
                while text[at] != 41 and text[at] != 40 and text[at] != 10:
                    comma = comma or text[at] == 44
                    at += 1
                told = comma and (begins == 68 or begins == 80 or begins == 77)  # D, P or M
                if told or text[at] != 41:
                    kind[line] = RARE
                    break
                at += 1
                continue
            meaning = _LETTERS[letter]
            if meaning == _NOTHING:
                kind[line] = RARE
                break
            at += 1
            while text[at] == 32 or text[at] == 9:
                at += 1
            minus = text[at] == 45
            if minus or text[at] == 43:
                at += 1
            whole, digits, significant, decimals, dot = 0, 0, 0, 0, False
            while True:
                digit = text[at] - 48
                if 0 <= digit <= 9:
                    digits += 1
                    if digit > 0 or significant > 0:
                        significant += 1
                    if significant > _MOST_DIGITS or decimals >= _MOST_DIGITS:
                        break
                    whole = whole * 10 + digit
                    if dot:
                        decimals += 1
                elif text[at] == 46 and not dot:
                    dot = True
                else:
                    break
                at += 1
            follower = text[at]
            if digits == 0 or follower == 46 or 48 <= follower <= 57:
                kind[line] = RARE
                break
            if meaning == _MOTION:
                if minus or dot or whole > 3 or code[line] != NO_CODE:
                    kind[line] = RARE
                    break
                code[line] = whole
                kind[line] = PLAIN
            elif meaning != _NUMBER:
                if not np.isnan(values[line, meaning]):
                    kind[line] = RARE
                    break
                value = whole / _POWERS[decimals]
                values[line, meaning] = -value if minus else value
                kind[line] = PLAIN
        while text[at] != 10:
            at += 1
        last[line] = at
        at += 1
        line += 1
    return line
