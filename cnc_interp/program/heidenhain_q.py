"""Formulas of Heidenhain: ``Q1 = Q2 + 5 * SIN Q3``, and the functions FN 1 to FN 13."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

Values = Callable[[str], float]  #: Returns the value of a parameter by its name.

_TOKEN = re.compile(r'\s*(?:(Q[LR]?\d+)|(\d+\.?\d*|\.\d+)|([A-Z]+)|(.))')
_FUNCTIONS: dict[str, Callable[[float], float]] = {
    'SIN': lambda x: math.sin(math.radians(x)),
    'COS': lambda x: math.cos(math.radians(x)),
    'TAN': lambda x: math.tan(math.radians(x)),
    'ASIN': lambda x: math.degrees(math.asin(x)),
    'ACOS': lambda x: math.degrees(math.acos(x)),
    'ATAN': lambda x: math.degrees(math.atan(x)),
    'SQRT': math.sqrt, 'SQ': lambda x: x * x, 'LN': math.log, 'LOG': math.log10, 'EXP': math.exp,
    'INT': lambda x: float(math.trunc(x)), 'ABS': abs, 'NEG': lambda x: -x,
    'FRAC': lambda x: math.modf(x)[0], 'SGN': lambda x: float((x > 0) - (x < 0)),
}  # fmt: skip
#: Conditions of FN 9 to FN 12.
CONDITIONS: dict[int, Callable[[float, float], bool]] = {
    9: lambda x, y: abs(x - y) < 1e-9,
    10: lambda x, y: abs(x - y) >= 1e-9,
    11: lambda x, y: x > y,
    12: lambda x, y: x < y,
}


class QError(Exception):
    """A formula cannot be read, or has no value."""


def formula(text: str, values: Values) -> float:
    """Return the value of a formula."""
    tokens = [match.group().strip() for match in _TOKEN.finditer(text.strip())]
    tokens = [token for token in tokens if token]
    try:
        value, rest = _sum(tokens, values)
    except (IndexError, ValueError):
        raise QError('the formula cannot be read; write for example Q1 = Q2 + 5') from None
    except ArithmeticError:
        raise QError('the formula has no value; correct its arguments') from None
    if rest or not math.isfinite(value):
        raise QError('the formula cannot be read; write for example Q1 = Q2 + 5')
    return value


def _sum(tokens: list[str], values: Values) -> tuple[float, list[str]]:
    value, rest = _product(tokens, values)
    while rest and rest[0] in '+-':
        sign, (other, rest) = rest[0], _product(rest[1:], values)
        value = value + other if sign == '+' else value - other
    return value, rest


def _product(tokens: list[str], values: Values) -> tuple[float, list[str]]:
    value, rest = _power(tokens, values)
    while rest and rest[0] in ('*', '/', 'DIV'):
        sign, (other, rest) = rest[0], _power(rest[1:], values)
        value = value * other if sign == '*' else value / other
    return value, rest


def _power(tokens: list[str], values: Values) -> tuple[float, list[str]]:
    value, rest = _atom(tokens, values)
    if rest and rest[0] == '^':
        other, rest = _power(rest[1:], values)
        value = value**other
    return value, rest


def _atom(tokens: list[str], values: Values) -> tuple[float, list[str]]:
    head, rest = tokens[0], tokens[1:]
    if head in '+-':
        value, rest = _atom(rest, values)
        return (-value if head == '-' else value), rest
    if head == '(':
        value, rest = _sum(rest, values)
        if rest[0] != ')':
            raise ValueError
        return value, rest[1:]
    if head in _FUNCTIONS:
        value, rest = _atom(rest, values)
        return _FUNCTIONS[head](value), rest
    if head == 'PI':
        return math.pi, rest
    return (values(head) if head.startswith('Q') else float(head)), rest


def _of_two(
    pattern: str, function: Callable[[float, float], float]
) -> Callable[[str, Values], float]:
    """Return a function of the text of FN, with its two values."""

    def value(text: str, values: Values) -> float:
        match = re.fullmatch(rf'(.*?)\s*(?:{pattern})\s*(.*)', text.strip()[1:])
        if match is None:
            raise QError('two values are missing; write for example FN 1: Q1 = +Q2 + +5')
        first, second = text.strip()[0] + match[1], match[2]
        return function(formula(first, values), formula(second, values))

    return value


def _of_one(name: str) -> Callable[[str, Values], float]:
    def value(text: str, values: Values) -> float:
        return _FUNCTIONS[name](formula(re.sub(rf'^\s*{name}\s*', '', text), values))

    return value


#: FN 1 to FN 8, and FN 13, which set a parameter.
FUNCTIONS: dict[int, Callable[[str, Values], float]] = {
    1: _of_two(r'\+(?=\s*[-+]?\s*[\dQ.])', lambda x, y: x + y),
    2: _of_two(r'-(?=\s*[-+]?\s*[\dQ.])', lambda x, y: x - y),
    3: _of_two(r'\*', lambda x, y: x * y),
    4: _of_two(r'DIV|/', lambda x, y: x / y),
    5: _of_one('SQRT'), 6: _of_one('SIN'), 7: _of_one('COS'),
    8: _of_two('LEN', math.hypot),
    13: _of_two('ANG', lambda x, y: math.degrees(math.atan2(x, y)) % 360.0),
}  # fmt: skip
