"""Expressions of G-code: the grammar of lines with expressions, and their values.

One grammar covers LinuxCNC, Fanuc macro B, Siemens, and formulas of Heidenhain, in which a
function precedes its value and a sign binds first. Angles are in deg.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

from lark import Lark, Transformer
from lark.exceptions import LarkError

_GRAMMAR = r"""
line: item*
values: bracketed*
condition: expression
formula: q_sum

?item: ADDRESS signed                          -> word
     | ADDRESS "=" expression                  -> word
     | (NAME | INDEXED) "=" expression         -> set_name
     | NAME "[" expression ("," expression)* "]" "=" expression -> set_element
     | "#" index "=" expression                -> set_parameter
     | NAME                                    -> key
     | NAME "(" [given ("," given)*] ")"       -> key
given: [expression]

?signed: atom
       | SIGN atom                             -> sign
?expression: unary
           | unary (_binary unary)+            -> chain
_binary: POWER | SIGN | TIMES | COMPARISON | BITS | LOGIC
?unary: atom
      | SIGN unary                             -> sign
      | NOT unary                              -> sign
?atom: NUMBER                                  -> number
     | STRING                                  -> text
     | "#" index                               -> parameter
     | bracketed
     | NAME "[" expression ("," expression)* "]" -> call
     | NAME "(" expression ("," expression)* ")" -> call
     | (NAME | INDEXED | R_NUMBER)             -> name
     | "(" expression ")"                      -> group
?bracketed: "[" expression "]"                 -> group
?index: NUMBER                                 -> number
      | "#" index                              -> parameter
      | "[" expression "]"                     -> group
      | NAME "[" expression "]"                -> call
      | NAME "[" expression "]" "/" bracketed  -> quotient
      | OWN_NAME                               -> own_name

?q_sum: q_product
      | q_sum SIGN q_product                   -> operation
?q_product: q_power
          | q_product Q_TIMES q_power          -> operation
?q_power: q_atom
        | q_atom Q_POWER q_power               -> operation
?q_atom: NUMBER                                -> number
       | Q_NAME                                -> name
       | SIGN q_atom                           -> sign
       | Q_FUNCTION q_atom                     -> call
       | "(" q_sum ")"                         -> group

SIGN: /[-+]/
POWER: "**"
TIMES.4: /\*(?!\*)|\/|(MOD|DIV)(?![A-Z_])/
COMPARISON.4: /==|<>|<=|>=|<|>|(EQ|NE|GE|GT|LE|LT)(?![A-Z_])/
BITS.4: /B_(AND|X?OR)(?![A-Z_])/
LOGIC.4: /(AND|X?OR)(?![A-Z_])/
NOT.4: /NOT(?![A-Z_])/
NUMBER: /(\d+(\.\d*)?|\.\d+)/
OWN_NAME: /<[^<>\[\]#]+>/
STRING: /"[^"]*"/
ADDRESS.2: /[A-Z](?![A-Z_])(?!\d+\s*=)/
INDEXED.3: /[A-Z]\d+(?=\s*=(?!=))/
R_NUMBER.3: /R\d+/
NAME: /[A-Z_$][A-Z_][A-Z0-9_]*/
Q_TIMES: /\*|\/|LEN|ANG/
Q_POWER: "^"
Q_NAME.2: /Q[LR]?\d+|PI(?![A-Z])/
Q_FUNCTION: /[A-Z]+/
%ignore /\s+/
"""
_TOO_DEEP = 'the expression is nested too deeply; use parameters'

#: Siemens names of axis positions, with their first variable number; and of the probe answer.
_PLACES = {'$AA_IW': 5041, '$P_EP': 5041, '$AA_IM': 5021, '$AA_MW': 5061}
_ANSWERED = {'$AC_MEA[1]': 5070}
_AXIS = re.compile(r'(\$\w+\s*\[\s*)([A-Z])(?=\s*\])')
_FIRST_TEXT = 1e9  #: Texts are numbered from this value on, so that they can be compared.

Node = Any


class ExpressionError(Exception):
    """An expression cannot be read or has no value; the reader adds file and line."""


class _Nodes(Transformer):  # type: ignore[type-arg]
    def __default__(self, data: Any, children: list[Any], meta: Any) -> Node:
        return (str(data), *children)


@cache
def _parser() -> Lark:
    start = ['line', 'values', 'condition', 'formula']
    return Lark(_GRAMMAR, start=start, lexer='contextual', maybe_placeholders=False, parser='lalr')


@lru_cache(maxsize=4096)
def parse(text: str, start: str = 'line') -> tuple[Node, ...]:
    if '$' in text:
        text = _AXIS.sub(r'\1"\2"', text)
    try:
        return tuple(_Nodes().transform(_parser().parse(text, start=start))[1:])
    except RecursionError:
        raise ExpressionError(_TOO_DEEP) from None
    except LarkError as problem:
        column = getattr(problem, 'column', None)
        rest = text[column - 1 :] if isinstance(column, int) and column > 0 else ''
        at = f'at {rest[:12].strip()!r}' if rest.strip() else 'at the end of the line'
        example = 'Q1 = Q2 + 5' if start == 'formula' else 'X[#1 + 2.5] or X=R1+2.5'
        how = f'write for example {example}'
        raise ExpressionError(f'the expression cannot be read {at}; {how}') from None


def formula(text: str, variables: ProgramVariables) -> float:
    try:
        return float(text)
    except ValueError:
        return evaluate(parse(text.replace('DIV', '/'), 'formula')[0], variables)


def evaluate(node: Node, variables: ProgramVariables) -> float:
    try:
        value = _value(node, variables)
    except RecursionError:
        raise ExpressionError(_TOO_DEEP) from None
    except (ArithmeticError, ValueError):
        raise ExpressionError('the expression has no value; correct its arguments') from None
    if not math.isfinite(value):
        raise ExpressionError('the value of the expression is not finite; correct its arguments')
    return value


def _value(node: Node, variables: ProgramVariables) -> float:
    kind = node[0]
    if kind == 'number':
        return float(node[1])
    if kind == 'text':
        return variables.number_of(str(node[1]).strip('"'))
    if kind == 'group':
        return _value(node[1], variables)
    if kind == 'parameter' and node[1][0] == 'own_name':
        return variables.named(str(node[1][1]))
    if kind == 'parameter':
        return variables.number(parameter_index(node[1], variables))
    if kind == 'name':
        return variables.named(str(node[1]))
    if kind == 'sign':
        value = _value(node[2], variables)
        return float(not value) if node[1] == 'NOT' else -value if node[1] == '-' else value
    if kind == 'call':
        return _call(str(node[1]), node[2:], variables)
    if kind == 'quotient':  # #ATAN[..]/[..]
        node = ('operation', ('call', node[1], node[2]), '/', node[3])
    if kind == 'chain':
        return _chain(node, variables)
    left, operator, right = node[1], str(node[2]), node[3]
    if operator == '/' and left[0] == 'call' and left[1] == 'ATAN' and right[0] == 'group':
        return _arc_tangent(_value(left[2], variables), _value(right, variables))
    if operator.split()[0] in _EQUAL and NOTHING in (left, right):
        # Fanuc: #0 equals only a variable without a value.
        other = right if left == NOTHING else left
        vacant = other[0] == 'parameter' and other[1][0] != 'own_name'
        vacant = vacant and variables.is_vacant(parameter_index(other[1], variables))
        return float(vacant is (operator.split()[0] in ('EQ', '==')))
    return float(OPERATORS[operator](_value(left, variables), _value(right, variables)))


def _chain(node: Node, variables: ProgramVariables) -> float:
    """Evaluate operands and operators without brackets; all readings must give the same value."""
    trees = {_tree(node, reading) for reading in variables.readings}
    values = {_value(tree, variables) for tree in trees}
    if len(values) > 1:
        operators = ' '.join(dict.fromkeys(str(operator) for operator in node[2::2]))
        raise ExpressionError(
            f'controls differ in how they compute {operators} here; write brackets, avoid MOD of '
            'negative or broken numbers, or choose --dialect'
        )
    return values.pop()


@lru_cache(maxsize=4096)
def _tree(node: Node, reading: Reading) -> Node:
    """Return a chain as a tree by the ranks of its operators; equal ranks from left to right."""
    operands, waiting = [node[1]], list[str]()

    def close(rank: int) -> None:
        while waiting and reading.rank(waiting[-1]) <= rank:
            right, left = operands.pop(), operands.pop()
            operator = waiting.pop()
            operands.append(('operation', left, reading.meanings().get(operator, operator), right))

    for operator, operand in zip(map(str, node[2::2]), node[3::2]):
        if operator == '/' and operands[-1][:2] == ('call', 'ATAN') and operand[0] == 'group':
            operands[-1] = ('operation', operands[-1], operator, operand)
            continue
        close(reading.rank(operator))
        waiting.append(operator)
        operands.append(operand)
    close(len(reading.ranks))
    return operands[0]


NOTHING = ('parameter', ('number', '0'))
_EQUAL = ('EQ', 'NE', '==', '<>')


def parameter_index(index: Node, variables: ProgramVariables) -> int:
    value = _value(index, variables)
    if not (abs(value - round(value)) < 1e-4 and 0 <= value < 1e6):
        raise ExpressionError(f'#{value:g} is not a parameter; write a whole number after #')
    return round(value)


def _call(name: str, arguments: tuple[Node, ...], variables: ProgramVariables) -> float:
    if name == 'EXISTS' and len(arguments) == 1 and arguments[0][0] == 'parameter':
        index = arguments[0][1]
        if index[0] == 'own_name':
            return float(variables.exists(str(index[1])))
        return float(1 <= parameter_index(index, variables) <= MOST_NUMBER)
    if name in _PLACES and len(arguments) == 1:
        axis = variables.text_of(_value(arguments[0], variables))
        if len(axis) != 1 or axis not in 'XYZABC':
            raise ExpressionError(f'{name} takes an axis, such as {name}[X]')
        return variables.number(_PLACES[name] + 'XYZABC'.index(axis))
    element = element_name(name, arguments, variables)
    if element in _ANSWERED:
        return variables.number(_ANSWERED[element])
    if variables.exists(element):
        return variables.named(element)
    if name not in _FUNCTIONS:
        raise ExpressionError(f'the function {name} is not supported; compute its value first')
    count, function = _FUNCTIONS[name]
    if len(arguments) not in count:
        raise ExpressionError(f'{name} takes {count[0]} argument(s), not {len(arguments)}')
    return float(function(*(_value(argument, variables) for argument in arguments)))


def element_name(name: str, indices: tuple[Node, ...], variables: ProgramVariables) -> str:
    """Return the name of an element of an array of Siemens, as ``A[2,0]``."""
    if name in _FUNCTIONS:
        return ''
    return f'{name}[{",".join(f"{_value(index, variables):g}" for index in indices)}]'


def elements_from(
    name: str, indices: tuple[Node, ...], series: Node, variables: ProgramVariables
) -> list[tuple[str, float]]:
    """Return the values that SET(a,b,..) or REP(a,count) gives to successive elements."""
    element, known = element_name(name, indices, variables), variables.elements(name)
    after = known[known.index(element) :] if element in known else [element]
    values = [_value(argument, variables) for argument in series[2:]]
    if series[1] == 'REP':
        values = values[:1] * int(values[1] if len(values) > 1 else len(after))
    if len(values) > len(after):
        raise ExpressionError(f'more values than elements of {name}; correct the size')
    return list(zip(after, values, strict=False))


OPERATORS: dict[str, Callable[[float, float], float]] = {
    '+': lambda x, y: x + y,
    '-': lambda x, y: x - y,
    '*': lambda x, y: x * y,
    '/': lambda x, y: x / y,
    **dict.fromkeys(('**', '^'), math.pow),
    'LEN': math.hypot,
    'ANG': lambda x, y: math.degrees(math.atan2(x, y)) % 360.0,
    'MOD': math.fmod,
    'MOD of LinuxCNC': lambda x, y: left if (left := math.fmod(x, y)) >= 0.0 else left + abs(y),
    'MOD of Fanuc': lambda x, y: math.fmod(_whole(x), _whole(y)),
    'DIV': lambda x, y: float(math.trunc(x / y)),
    **dict.fromkeys(('AND of bits', 'B_AND'), lambda x, y: _whole(x) & _whole(y)),
    **dict.fromkeys(('OR of bits', 'B_OR'), lambda x, y: _whole(x) | _whole(y)),
    **dict.fromkeys(('XOR of bits', 'B_XOR'), lambda x, y: _whole(x) ^ _whole(y)),
    'EQ of LinuxCNC': lambda x, y: abs(x - y) < 1e-4,
    'NE of LinuxCNC': lambda x, y: abs(x - y) >= 1e-4,
    'AND': lambda x, y: bool(x) and bool(y),
    'OR': lambda x, y: bool(x) or bool(y),
    'XOR': lambda x, y: bool(x) != bool(y),
    **dict.fromkeys(('EQ', '=='), lambda x, y: abs(x - y) < 1e-6),
    **dict.fromkeys(('NE', '<>'), lambda x, y: abs(x - y) >= 1e-6),
    **dict.fromkeys(('GT', '>'), lambda x, y: x > y),
    **dict.fromkeys(('GE', '>='), lambda x, y: x >= y),
    **dict.fromkeys(('LT', '<'), lambda x, y: x < y),
    **dict.fromkeys(('LE', '<='), lambda x, y: x <= y),
}


_COMPARED = 'EQ NE GT GE LT LE == <> > >= < <='


@dataclass(frozen=True)
class Reading:
    """The rules of a control for operators without brackets."""

    ranks: tuple[str, ...]  #: Operators of each rank; those that bind first come first.
    changed: tuple[tuple[str, str], ...] = ()  #: Operators, and those that they mean.

    def rank(self, operator: str) -> int:
        return next(k for k, rank in enumerate(self.ranks) if operator in rank.split())

    def meanings(self) -> dict[str, str]:
        return dict(self.changed)


#: NIST's RS274/NGC and LinuxCNC: logic has one rank, below comparisons.
READ_BY_LINUXCNC = Reading(
    ('**', '* / MOD DIV', '+ -', _COMPARED, 'AND OR XOR B_AND B_OR B_XOR'),
    (
        ('MOD', 'MOD of LinuxCNC'),
        *((x, 'EQ of LinuxCNC') for x in ('EQ', '==')),
        *((x, 'NE of LinuxCNC') for x in ('NE', '<>')),
    ),
)
_FANUC_MEANS = (('MOD', 'MOD of Fanuc'), *((x, f'{x} of bits') for x in ('AND', 'OR', 'XOR')))
#: Fanuc's custom macro B computes with bits: AND among the products, OR and XOR among the sums.
READ_BY_FANUC = Reading(
    ('**', '* / MOD DIV AND B_AND', '+ - OR XOR B_OR B_XOR', _COMPARED), _FANUC_MEANS
)
#: Siemens documents comparisons as the last rank; programs use them as in other languages.
READ_BY_SIEMENS = Reading(
    ('**', '* / MOD DIV', '+ -', 'B_AND', 'B_XOR', 'B_OR', 'AND', 'XOR', 'OR', _COMPARED)
)
_USUAL_RANKS = (
    '**',
    '* / MOD DIV',
    '+ -',
    'B_AND',
    'B_XOR',
    'B_OR',
    _COMPARED,
    'AND',
    'XOR',
    'OR',
)
USUAL, USUAL_OF_BITS = Reading(_USUAL_RANKS), Reading(_USUAL_RANKS, _FANUC_MEANS)


def _whole(value: float) -> int:
    """Return the nearest whole number, halves away from zero as controls round."""
    return int(math.copysign(math.floor(abs(value) + 0.5), value))


def _at_half(value: float) -> float:
    """Round to a whole or half number other than 0 if very near, so that SIN[30] is 0.5."""
    nearest = round(2.0 * value) / 2.0
    near = nearest and abs(value - nearest) < 1e-15 * max(1.0, abs(value))
    return nearest if near else value


def _tangent(x: float) -> float:
    if abs(math.cos(math.radians(x))) < 1e-15:
        raise ValueError
    return _at_half(math.tan(math.radians(x)))


def _arc_tangent(y: float, x: float = 1.0) -> float:
    return _at_half(math.degrees(math.atan2(y, x)))


_FUNCTIONS: dict[str, tuple[tuple[int, ...], Callable[..., float]]] = {
    'ABS': ((1,), abs),
    'SQRT': ((1,), math.sqrt),
    'SQR': ((1,), math.sqrt),
    **dict.fromkeys(('POT', 'SQ'), ((1,), lambda x: x * x)),
    'SIN': ((1,), lambda x: _at_half(math.sin(math.radians(x)))),
    'COS': ((1,), lambda x: _at_half(math.cos(math.radians(x)))),
    'TAN': ((1,), _tangent),
    'ASIN': ((1,), lambda x: _at_half(math.degrees(math.asin(x)))),
    'ACOS': ((1,), lambda x: _at_half(math.degrees(math.acos(x)))),
    'ATAN': ((1, 2), _arc_tangent),
    'ATAN2': ((2,), _arc_tangent),
    'EXP': ((1,), math.exp),
    'LN': ((1,), math.log),
    'LOG': ((1,), math.log10),
    'NEG': ((1,), lambda x: -x),
    'FRAC': ((1,), lambda x: math.modf(x)[0]),
    'SGN': ((1,), lambda x: float((x > 0) - (x < 0))),
    'FIX': ((1,), lambda x: float(math.floor(x))),
    'FUP': ((1,), lambda x: float(math.ceil(x))),
    'ROUND': ((1,), lambda x: float(_whole(x))),
    **dict.fromkeys(('TRUNC', 'INT'), ((1,), lambda x: float(math.trunc(x)))),
    'MINVAL': ((2,), min),
    'MAXVAL': ((2,), max),
}


MOST_LOCAL = 33  #: ``#1`` to this number are local in a subprogram that is called with arguments.
#: The largest number of a parameter of LinuxCNC, for EXISTS.
MOST_NUMBER = 5602
_CONSTANTS = {
    'TRUE': 1.0,
    'FALSE': 0.0,
    '$PI': math.pi,
    'PI': math.pi,
    '_OFF': 0.0,
    '_FINISH': 1.0,
    '_SEMIFIN': 2.0,
    '_ROUGH': 3.0,
}
_MOST_VARIABLES = 100_000

UNSET = 'is read before it is set; set it in the program'
#: First variable that a control sets itself, and variables with modal words.
OF_CONTROL, MODAL = 4001, range(4001, 4201)
UNKNOWN = 'is not known here; write its value'


class ProgramVariables:
    def __init__(
        self,
        system: Callable[[], Mapping[int, float]],
        names: Callable[[], Mapping[str, float]],
        readings: tuple[Reading, ...] = (USUAL,),
    ):
        self._system, self._predefined = system, names
        self.readings = readings
        self._numbers: dict[int, float] = {}
        self._names: dict[str, float] = {}
        self._locals: list[tuple[dict[int, float], dict[str, float]]] = []
        self._texts: list[str] = []  # their numbers come from ``number_of``
        self._vacant: list[bool] = []  # whether locals that are not set have no value (G65)

    def follow(self, before: ProgramVariables) -> None:
        self._numbers, self._names = dict(before._numbers), dict(before._names)
        self._texts = list(before._texts)

    def enter(self, arguments: Mapping[int, float], vacant: bool) -> None:
        self._locals.append((dict(arguments), {}))
        self._vacant.append(vacant)

    def leave(self) -> None:
        self._locals.pop()
        self._vacant.pop()

    def state(self) -> tuple[Any, ...]:
        return deepcopy((self._numbers, self._names, self._locals)) + (dict(self._system()),)

    def stands_as(self, before: tuple[Any, ...]) -> bool:
        now = self._numbers, self._names, self._locals
        return now == before[:3] and dict(self._system()) == before[3]

    def _with(self, index: int) -> dict[int, float]:
        local = self._locals and 1 <= index <= MOST_LOCAL
        return self._locals[-1][0] if local else self._numbers

    def number(self, index: int) -> float:
        """Return variable ``#index``; local variables of an O- SUB are 0 until they are set."""
        found = self._with(index)
        if index in found:
            return found[index]
        if found is not self._numbers and not self._vacant[-1]:
            return 0.0
        if index >= OF_CONTROL and index in (system := self._system()):
            return system[index]
        if index in MODAL:
            raise ExpressionError(f'the system variable #{index} {UNKNOWN}')
        raise ExpressionError(f'#{index} {UNSET}')

    def is_vacant(self, index: int) -> bool:
        return index not in self._with(index) and (
            index < OF_CONTROL or index not in self._system()
        )

    def set_number(self, index: int, value: float) -> None:
        found = self._with(index)
        if math.isnan(value):
            found.pop(index, None)
        elif found is self._numbers and (index == 0 or index >= 5000):
            raise ExpressionError(f'#{index} cannot be set from a program; use #100 to #4999')
        else:
            found[index] = value

    def named(self, name: str) -> float:
        names = self._table(name)
        if name in names:
            return names[name]
        if name in _CONSTANTS:
            return _CONSTANTS[name]
        if name.startswith('<_') and name in (predefined := self._predefined()):
            return predefined[name]
        shown = f'#{name}' if name.startswith('<') else name
        raise ExpressionError(f'{shown} {UNSET}')

    def number_of(self, text: str) -> float:
        """Return the number that represents a text, or the name of an axis."""
        if text not in self._texts:
            self._texts.append(text)
        return _FIRST_TEXT + self._texts.index(text)

    def text_of(self, number: float) -> str:
        known = dict(enumerate(self._texts))
        return known.get(round(number - _FIRST_TEXT), '')

    def elements(self, name: str) -> list[str]:
        """Return the elements of an array, in their order."""
        return [each for each in self._names if each.startswith(f'{name}[')]

    def set_name(self, name: str, value: float) -> None:
        names = self._table(name)
        if len(names) >= _MOST_VARIABLES:
            raise ExpressionError(f'more than {_MOST_VARIABLES:,} variables; use fewer names')
        names[name] = value

    def exists(self, name: str) -> bool:
        return name in self._table(name) or (name.startswith('<_') and name in self._predefined())

    def _table(self, name: str) -> dict[str, float]:
        local = name.startswith('<') and not name.startswith('<_')
        return self._locals[-1][1] if self._locals and local else self._names
