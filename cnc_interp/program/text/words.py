"""One line of G-code as words: comments, words with and without spaces, key words."""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from math import nan
from typing import Any

from cnc_interp.core import DependsOn, ProgramError
from cnc_interp.program.text import expressions
from cnc_interp.program.text.code_tables import HARMLESS_KEYS, refused_key

# The look-ahead after each number and name rejects every shorter match. So a line of a million
# digits fails in linear time. Possessive quantifiers would do the same, but fail in Python 3.11.2.
_NUMBER = r'[-+]?(?:\d+(?:\.\d*)?|\.\d+)'
_TOKEN = re.compile(
    rf"""
    (?P<letter>[A-Z])\s*(?:=\s*)?(?P<number>{_NUMBER})(?![\d.=])(?!\s*=)
    | (?P<name>[XYZ]H|[ABC]3|PL|SD|PW)\s*=\s*(?P<value>{_NUMBER})(?![\d.]|EX|\s*[-+*/\[])
    | (?P<text>T\s*=\s*"[^"]*")
    | (?P<key>\#\s*TRAFO\s+(?:ON|OFF)\b | [A-Z_]{{2}}\w*(?!\w|\s*[=(]))
    | (?P<space>\s+)
    """,
    re.VERBOSE,
)
#: Calls that move nothing; their arguments are names or texts.
_IDLE_CALL = re.compile(
    rf'(?<![A-Z0-9_])({"|".join(sorted(HARMLESS_KEYS))})\s*\((?:[^()"]|"[^"]*"|\([^()]*\))*\)'
)
#: Limits of an axis, as ACC[X]=60; and an axis by its name, as AX[X]=10.
_LIMIT_OF_AXIS = re.compile(
    r'(?<!\w)((?:ACC|ACCLIM|VELOLIM|JERKLIM)A?|FGREF)\s*\[\s*\w+\s*\]\s*=\s*\S+'
)
_NAMED_AXIS = re.compile(r'(?<!\w)AX\s*\[\s*([A-Z])\s*\]\s*=')
#: Corners and angles of Fanuc, as ,R5 ,C2 ,A30.
_CORNER = re.compile(r',\s*([RCA])(?=\s*[-+.\d#\[])')
_CORNER_NAMES = {'R': ' RND=', 'C': ' CHR=', 'A': ' ANG='}
_EXPRESSION_SIGNS = re.compile(r'[#\[\]=<>*]|\w\s*\(')
_TRAFO = re.compile(r'#\s*TRAFO\b')
_TOOL_NAME = re.compile(r'\bT\s*=\s*"[^"]*"')
#: Functions that qualify an axis word: absolute, incremental, or direction of turn.
WAYS = ('AC', 'IC', 'DC', 'ACP', 'ACN')
# X1E-3 could be a small number, or X1 and a separate word E of an extruder.
_EXPONENT = re.compile(r'(?:(?<![A-Z_<"])[A-Z](?:\s*=)?\s*|(?<![\w.<"]))[-+]?([\d.]+E[-+]?\d+)')
# A name of several letters before a parenthesis, but not a word with a number as in M6(TOOL 3).
_GROUP_BEFORE = re.compile(
    r'(?:[-+*/=,<>]\s*|(?<![A-Z0-9_])(?:(?!(?:GOTO[FBC]?|DO|END|THEN|ELSE|ENDIF|END\s*SUB|SUB)\d*$)[A-Z_][A-Z_]\w*|(?:IF|WHILE|UNTIL|CASE|AND|OR|NOT|'
    r'(?:CYCLE|HOLES|SLOT|POCKET|LONGHOLE)\d*)\s+))$'
)

_NAMED = re.compile(r'#<[^<>]*>\s*$')  # > ends a name here, and compares nothing


@dataclass
class BlockWords:
    #: Codes in their shortest form ('G1', 'G43.4', 'M3'), in the order of the line.
    g: list[str] = field(default_factory=list)
    m: list[str] = field(default_factory=list)
    #: Number and text of every other word, by letter.
    values: dict[str, float] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    #: Function of an axis word, by letter: 'AC', 'IC', 'DC', 'ACP' or 'ACN'.
    ways: dict[str, str] = field(default_factory=dict)
    #: Words of several letters ('TRAORI'), and numbers in parentheses; None: empty, or a text.
    keys: list[tuple[str, tuple[float | None, ...]]] = field(default_factory=list)
    #: Assignments to parameters (int) and names (str), in the order of the line.
    sets: list[tuple[int | str, float]] = field(default_factory=list)
    second_tool: float | None = None  #: A second T: the tool that follows (Mazak).
    #: Words after G65, which may have several sets of I J K.
    arguments: list[tuple[str, float]] = field(default_factory=list)

    def put(self, letter: str, value: float, text: str = '') -> None:
        """Put a word into the block; ``text``: how it is written, if not as letter and number."""
        self.values[letter], self.texts[letter] = value, text or f'{letter}{value:g}'

    def take(self, letters: Iterable[str]) -> dict[int, float]:
        """Remove the words with these letters; return their values by index in ``letters``."""
        found = enumerate(letters)
        return {i: self.values.pop(letter) for i, letter in found if letter in self.values}


Fault = Callable[[str, str, DependsOn], ProgramError]


def without_comments(line: str, fault: Fault) -> str:
    """Remove comments, but keep parentheses after operators or names, as in CYCLE832(...)."""
    if ';' not in line and '(' not in line:
        return line
    kept, at, size, quoted, depth = [], 0, len(line), False, 0
    while at < size:
        sign = line[at]
        if sign == '"':
            quoted = not quoted
        elif not quoted and sign == ';':
            break
        elif not quoted and sign == '(':
            before = line[max(0, at - 80) : at]
            if not depth and (_NAMED.search(before) or not _GROUP_BEFORE.search(before)):
                at = _end_of_comment(line, at, fault)
                kept.append(' ')
                continue
            depth += 1
        elif not quoted and sign == ')' and depth:
            depth -= 1
        kept.append(sign)
        at += 1
    return ''.join(kept).strip()


def _end_of_comment(line: str, at: int, fault: Fault) -> int:
    depth = 0
    for here in range(at, len(line)):
        depth += (line[here] == '(') - (line[here] == ')')
        if depth == 0:
            return here + 1
    raise fault('the comment is not closed; add )', line[at:].split()[0], DependsOn.LINE)


def split_words(line: str, variables: expressions.ProgramVariables, fault: Fault) -> BlockWords:
    """Split one line of G-code into words. The line is in upper case and without comments."""
    if '(' in line:
        line = _IDLE_CALL.sub(r'\1 ', line)
    if ',' in line and '(' not in line:
        line = _CORNER.sub(_corner_word, line)
    if '[' in line and any(name in line for name in ('AX', 'ACC', 'LIMA', 'FGREF')):
        line = _NAMED_AXIS.sub(r' \1=', _LIMIT_OF_AXIS.sub(r' \1 ', line))
    if 'E' in line and (exponent := _EXPONENT.search(line)):
        raise fault('a number with an exponent; write all its digits', exponent[1], DependsOn.LINE)
    words = BlockWords()
    at = 0
    while at < len(line):
        token = _TOKEN.match(line, at)
        if token is None:
            # After words such as FOR or PROC the rest has another syntax: report this word.
            for key, _ in words.keys:
                if why := refused_key(key):
                    raise fault(why, key, DependsOn.LINE)
            if _EXPRESSION_SIGNS.search(line) and not _TRAFO.search(line):
                return _by_grammar(line, variables, fault)
            raise _no_word(line, at, fault)
        at = token.end()
        letter, key = token['letter'], token['key']
        if letter or token['text']:
            _add(words, letter or 'T', float(token['number'] or 0.0), token[0], fault)
        elif token['name']:
            words.sets.append((token['name'], float(token['value'])))
        elif key in expressions.OPERATORS:
            return _by_grammar(line, variables, fault)
        elif key:
            words.keys.append((re.sub(r'\s+', ' ', key).replace('# ', '#'), ()))
    return words


def _corner_word(match: re.Match[str]) -> str:
    before = match.string[: match.start()]
    inside = before.count('[') > before.count(']')  # of an array
    return match[0] if inside else _CORNER_NAMES[match[1]]


def _add(words: BlockWords, letter: str, value: float, text: str, fault: Fault) -> None:
    if letter in 'GM':
        code = f'{letter}{round(value, 3):g}'
        code = 'G53' if code == 'G153' else code
        (words.g if letter == 'G' else words.m).append(code)
        return
    if letter == 'T' and 'T' in words.values and words.second_tool is None:
        words.second_tool = value
        return
    if 'G65' in words.g:
        words.arguments.append((letter, value))
    if letter in words.values and not (letter in 'IJK' and words.arguments):
        raise fault(
            f'{letter} is written twice in one block; keep one of them', text, DependsOn.LINE
        )
    words.put(letter, value, text)


def _by_grammar(line: str, variables: expressions.ProgramVariables, fault: Fault) -> BlockWords:
    words = BlockWords()
    if name := _TOOL_NAME.search(line):
        _add(words, 'T', 0.0, name[0], fault)
        line = line.replace(name[0], ' ')
    word = line.split()[0] if line.split() else line
    try:
        items = expressions.parse(line)
    except expressions.ExpressionError as problem:
        raise fault(str(problem), word, DependsOn.LINE) from None
    try:
        for item in items:
            kind, word = item[0], str(item[1])
            if kind == 'word':
                _add_expression(words, word, item[2], variables, fault)
            elif kind == 'set_name':
                words.sets.append((word, expressions.evaluate(item[2], variables)))
            elif kind == 'set_element' and word == 'AX':
                word = variables.text_of(expressions.evaluate(item[2], variables))
                _add_expression(words, word, item[3], variables, fault)
            elif kind == 'set_element' and item[-1][:2] in (('call', 'SET'), ('call', 'REP')):
                words.sets += expressions.elements_from(word, item[2:-1], item[-1], variables)
            elif kind == 'set_element':
                word = expressions.element_name(word, item[2:-1], variables)
                words.sets.append((word, expressions.evaluate(item[-1], variables)))
            elif kind == 'set_parameter':
                word = '#'
                value = (
                    nan
                    if item[2] == expressions.NOTHING
                    else expressions.evaluate(item[2], variables)
                )
                if item[1][0] == 'own_name':
                    words.sets.append((str(item[1][1]), value))
                else:
                    words.sets.append((expressions.parameter_index(item[1], variables), value))
            else:
                if why := refused_key(word):
                    raise fault(why, word, DependsOn.LINE)
                words.keys.append((word, tuple(_given(node, variables) for node in item[2:])))
    except expressions.ExpressionError as problem:
        raise fault(str(problem), word, DependsOn.STATE) from None
    return words


def _add_expression(
    words: BlockWords,
    letter: str,
    node: Any,
    variables: expressions.ProgramVariables,
    fault: Fault,
) -> None:
    if node[0] == 'call' and node[1] in WAYS and len(node) == 3:
        words.ways[letter], node = str(node[1]), node[2]
    value = expressions.evaluate(node, variables)
    _add(words, letter, value, f'{letter}{value:g}', fault)


def _given(node: Any, variables: expressions.ProgramVariables) -> float | None:
    if len(node) == 1 or node[1][0] == 'text':
        return None
    return expressions.evaluate(node[1], variables)


def _no_word(line: str, at: int, fault: Fault) -> ProgramError:
    rest = line[at:]
    chunk = rest.split()[0]
    if not chunk.isprintable():
        message, chunk = 'this is not text; give a part program', ascii(chunk)
    elif rest[0].isdigit() or rest[0] in '+-.':
        message = 'a number without a letter; write for example X10'
    elif re.fullmatch(r'[A-Z]', chunk) or re.match(r'[A-Z][-+.]*(?![\d.A-Z])', chunk):
        message = 'a letter without a number; write for example X10'
    elif re.match(r',\d', rest):
        message = 'a decimal comma; write a point, for example X30.5'
    elif re.match(r'[A-Z]', chunk):
        message = 'not a number; write for example X10.5'
    else:
        message = 'not a word of G-code; remove it or put it into a comment'
    return fault(message, chunk, DependsOn.LINE)
