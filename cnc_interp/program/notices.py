"""Messages of a program reader: notices of words without effect, and rejected lines."""

import re
import sys
from collections import Counter
from collections.abc import Iterable, Sequence

from cnc_interp.core import DependsOn, ProgramError, RefusedLinesError

#: Prefix of notices that require an action before the tool cuts.
WARNING = 'WARNING: '


def warnings_of(notices: Iterable[str]) -> list[str]:
    return [notice for notice in notices if WARNING in notice]


def tell(notices: Sequence[str]) -> None:
    warnings = warnings_of(notices)
    for notice in notices:
        if notice not in warnings:
            print(f'note: {notice}', file=sys.stderr)
    for warning in warnings:
        red = '\033[1;31m{}\033[0m' if sys.stderr.isatty() else '{}'
        print(red.format(warning), file=sys.stderr)


class Notices:
    def __init__(self) -> None:
        self._texts: dict[str, str] = {}

    def once(self, key: str, line_number: int, text: str) -> None:
        if key not in self._texts:
            self._texts[key] = f'line {line_number}: {text}'

    def texts(self) -> tuple[str, ...]:
        return tuple(self._texts.values())


#: Number of different refusals, and of rejected lines, after which reading ends.
MOST, MOST_LINES = 20, 1000
#: Number of lines named per refusal; number of refusals above which a table lists their words.
NAMED, NAMED_ALONE = 5, 3
#: The code or the letters with which a word begins.
_HEAD = re.compile(r'[GM]\d+(?:\.\d+)?|[A-Z_]+|\S+', re.IGNORECASE)


class Refusals:
    """Rejected lines of a program, collected while the rest of it is read.

    After a rejected line neither the position nor the modal state is known. Refusals that depend
    on them are dropped, such as an arc with a wrong start, or a missing feed.
    """

    def __init__(self) -> None:
        self._alike: dict[tuple[str, str, str], list[ProgramError]] = {}
        self._count = 0
        #: Whether the position, and the modal state, are unknown.
        self._is_lost = self._is_unset = False

    def __bool__(self) -> bool:
        return self._count > 0

    def add(self, problem: ProgramError, ends: bool = False) -> None:
        """Store a refusal unless an earlier one may be its cause; raise if there are too many."""
        on = problem.depends_on
        key = problem.source, problem.message, problem.word
        place, state = on is DependsOn.PLACE, on in (DependsOn.STATE, DependsOn.LEFT_OVER)
        follows = (place and self._is_lost) or (state and self._is_unset)
        self._count += 1
        if not follows or ends or key in self._alike:
            alike = self._alike.setdefault(key, [])
            if not alike or problem.line_number != alike[-1].line_number:
                alike.append(problem)
        if on is not DependsOn.LEFT_OVER:
            self._is_lost, self._is_unset = True, self._is_unset or not place
        if len(self._alike) >= MOST or self._count >= MOST_LINES:
            raise self.error(ended=True)

    def arrive(self) -> None:
        self._is_lost = False

    def _table(self) -> str:
        counts: Counter[str] = Counter()
        for (_, message, word), alike in self._alike.items():
            head = _HEAD.match(word)
            counts[head[0] if head else message.split(';')[0]] += len(alike)
        words = ', '.join(f'{word} in {count}' for word, count in counts.most_common())
        return f'{counts.total()} refused lines: {words}'

    def error(self, ended: bool = False) -> ProgramError:
        """Return an error with all refusals; ``ended``: whether reading stopped early."""
        first = [problem for problem, *_ in self._alike.values()]
        if sum(map(len, self._alike.values())) == 1 and not ended:
            return first[0]
        texts = []
        for problem, *others in self._alike.values():
            named = ', '.join(str(other.line_number) for other in others[:NAMED])
            rest = f' and {len(others) - NAMED} more' if len(others) > NAMED else ''
            lines = 'lines' if len(others) > 1 else 'line'
            texts.append(f'{problem} (also {lines} {named}{rest})' if others else str(problem))
        if len(first) > NAMED_ALONE:
            texts.append(self._table())
        if ended:
            texts.append('there may be more; the reading ended here')
        return RefusedLinesError(first, '\n'.join(texts))
