"""A line of G-code as words; comments of both kinds, packed and spaced words, key words."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from cnc_interp.errors import ProgramError
from cnc_interp.program.codes import refused_key

# Possessive quantifiers: a line of a million digits must fail at once, not be tried in every way.
_NUMBER = r'[-+]?(?:\d++(?:\.\d*+)?|\.\d++)'
_AXES = ''.join(rf'(?:{letter}\s*({_NUMBER})\s*)?' for letter in 'XYZABC')

# Nearly every line of a program has this form. Groups: G0 or G1, X Y Z A B C, F.
PLAIN_MOTION = re.compile(
    rf'(?:N\s*\d+\s*)?(?:G0?([01])(?![\d.])\s*)?{_AXES}(?:F\s*({_NUMBER})\s*)?'
)

_TOKEN = re.compile(
    rf"""
    (?P<letter>[A-Z])\s*=?\s*(?P<number>{_NUMBER})(?![\d.=])
    | (?P<text>T\s*=\s*"[^"]*")
    | (?P<key>\#\s*TRAFO\s+(?:ON|OFF)\b | [A-Z_][A-Z_]+\w*) (?P<call>\((?:"[^"]*"|[^()"])*\))?
    | (?P<comment>\((?:[^()]|\([^()]*+\))*+\) | ;.*)
    | (?P<space>\s+)
    """,
    re.VERBOSE,
)

_EXPRESSION = (
    'variables and expressions are not supported yet; post the program with plain numbers'
)


@dataclass
class BlockWords:
    """
    The words of one line.

    Parameters
    ----------
    g, m : list of str
        Codes in their shortest form ('G1', 'G43.4', 'M3'), in the order written.
    values, texts : dict
        Number and written form of every other word, by letter.
    keys : list of str
        Words of more than one letter, without their arguments ('TRAORI', '#TRAFO ON').

    """

    g: list[str] = field(default_factory=list)
    m: list[str] = field(default_factory=list)
    values: dict[str, float] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    keys: list[str] = field(default_factory=list)


def split_words(line: str, source: str, line_number: int) -> BlockWords:
    """
    Split one line of G-code, in upper case, into its words.

    Raises
    ------
    ProgramError
        If a part of the line is no word, or a letter other than G and M stands twice.

    """
    words = BlockWords()
    at = 0
    while at < len(line):
        token = _TOKEN.match(line, at)
        if token is None:
            # After a word such as IF or DEF the rest follows other rules: name that word instead.
            for key in words.keys:
                if why := refused_key(key):
                    raise ProgramError(why, source, line_number, key)
            raise _fault(line, at, source, line_number)
        at = token.end()
        letter, key = token['letter'], token['key']
        if letter in ('G', 'M'):
            code = f'{letter}{float(token["number"]):g}'
            (words.g if letter == 'G' else words.m).append(code)
        elif letter or token['text']:
            letter = letter or 'T'
            if letter in words.values:
                raise ProgramError(
                    f'{letter} stands twice in one block; keep one of them',
                    source,
                    line_number,
                    token[0],
                )
            words.values[letter] = float(token['number'] or 0.0)
            words.texts[letter] = token[0]
        elif key:
            words.keys.append(re.sub(r'\s+', ' ', key).replace('# ', '#'))
    return words


def _fault(line: str, at: int, source: str, line_number: int) -> ProgramError:
    """Say what is wrong with the rest of a line that begins with no word."""
    rest = line[at:]
    chunk = rest.split()[0]
    if rest[0] == '(':
        message = 'the comment is not closed; add )'
    elif any(sign in chunk for sign in '=#[]<>"*'):
        message, chunk = _EXPRESSION, line[line.rfind(' ', 0, at) + 1 :].split()[0]
    elif not chunk.isprintable():
        message, chunk = 'this is no text; give a part program', ascii(chunk)
    elif rest[0].isdigit() or rest[0] in '+-.':
        message = 'a number without a letter; write for example X10'
    elif re.fullmatch(r'[A-Z]', chunk) or re.match(r'[A-Z][-+.]*(?![\d.A-Z])', chunk):
        message = 'a letter without a number; write for example X10'
    elif re.match(r'[A-Z]', chunk):
        message = 'not a number; write for example X10.5'
    else:
        message = 'not a word of G-code; remove it or put it into a comment'
    return ProgramError(message, source, line_number, chunk[:40])
