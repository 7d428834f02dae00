"""Instances of HAL's modules that are added to a HAL file, and how their pins are connected."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from cnc_interp.core import InterpError
from cnc_interp.machine.hal_pins import BITS

#: Words of ``halcmd`` that connect pins, with the index of the signal among their names.
LINKS = {'net': 0, 'linksp': 0, 'linkps': 1, 'linkpp': 0}
MOST_THREADS = 3
SPECIAL = 'threads', 'weighted_sum'  #: Modules whose instances have no names.
Inputs = dict[
    str, str | float
]  #: Values of the inputs of an instance, or the pins that they read.
Resolve = Callable[[str], str]  #: Returns the value of a word like ``[SECTION]KEY`` in the INI.


@dataclass
class Board:
    first_sum: int  #: Number of the first ``weighted_sum``, after those of the configuration.
    modules: dict[str, list[str]] = field(default_factory=dict)  #: Instances by module.
    #: Functions in the order in which they are called.
    functions: list[str] = field(default_factory=list)
    nets: dict[str, list[str]] = field(default_factory=dict)  #: Pins that read a pin.
    names: dict[str, str] = field(default_factory=dict)  #: Signals of pins, where they have one.
    settings: list[str] = field(default_factory=list)

    def add(self, module: str, name: str, inputs: Mapping[str, str | float] | None = None) -> str:
        """Add an instance of a module; inputs are numbers or pins. Return its output pin."""
        self.modules.setdefault(module, []).append(name)
        self.functions.append(name)
        for pin, value in (inputs or {}).items():
            if isinstance(value, str):
                self.connect(value, f'{name}.{pin}')
            else:
                self.settings.append(f'setp {name}.{pin} {value}')
        return f'{name}.out'

    def connect(self, source: str, *readers: str, name: str = '') -> None:
        self.nets.setdefault(self.pin(source), []).extend(map(self.pin, readers))
        if name:
            self.names[self.pin(source)] = name

    def pin(self, name: str) -> str:
        """Return the name of a pin; a ``weighted_sum`` is renumbered from ``first_sum``."""
        return re.sub(r'wsum\.(\d+)', lambda n: f'wsum.{int(n[1]) + self.first_sum}', name)

    def lines(self, done: set[str]) -> list[str]:
        """Return ``net`` lines for the connections whose pins are not in ``done``."""
        return [
            ' '.join(['net', self.names.get(pin, f'cnc-{pin}'.replace('.', '-')), pin, *readers])
            for pin, readers in self.nets.items()
            if readers and pin not in done
        ]


@dataclass
class Row:
    """A line of a HAL file."""

    line: str
    words: list[str]

    @property
    def given(self) -> dict[str, str]:
        return dict(word.split('=', 1) for word in self.words if '=' in word)


def rows_of(text: str) -> list[Row]:
    """Return the lines of a HAL file; lines that connect pins become ``net SIGNAL PIN ...``."""
    found = []
    for line in text.replace('\\\n', ' ').splitlines():
        words = line.partition('#')[0].split()
        if len(words) > 1 and words[0] in LINKS:
            pins = [word for word in words[1:] if '=' not in word]
            signal = pins.pop(LINKS[words[0]] if len(pins) > 1 else 0)
            first = [signal] if words[0] == 'linkpp' else []
            words = ['net', signal, *first, *pins]
        found.append(Row(line, words))
    return found


def connected(rows: Sequence[Row]) -> dict[str, int]:
    """Return by pin the index of the row that still connects it after ``unlinkp``, ``delsig``."""
    found: dict[str, int] = {}
    for k, words in ((k, row.words) for k, row in enumerate(rows)):
        if words[:1] == ['net'] and len(words) > 1:
            found |= dict.fromkeys(words[2:], k)
        elif words[:1] == ['unlinkp'] and len(words) > 1:
            found.pop(words[1], None)
        elif words[:1] == ['delsig'] and len(words) > 1:
            found = {pin: n for pin, n in found.items() if rows[n].words[1] != words[1]}
    return found


class Loads:
    """Instances of modules in a configuration and on a board; HAL loads each module only once."""

    def __init__(self, rows: Sequence[Row], resolve: Resolve):
        self._resolve = resolve
        self._given: dict[str, list[Row]] = {}
        for row in rows:
            if row.words[:1] == ['loadrt'] and len(row.words) > 1:
                self._given.setdefault(row.words[1], []).append(row)
        for module in ('streamer', 'sampler'):
            if module in self._given:
                raise InterpError(f'loadrt {module}: cnc_interp itself needs the first instance')
        self.merged = {m: each for m, each in self._given.items() if m in SPECIAL}
        self.board = Board(len(self._list('weighted_sum', 'wsum_sizes')))

    def merge(self) -> None:
        """Merge the loads of modules that both need, and loads that the configuration repeats."""
        self.merged |= {
            module: each
            for module, each in self._given.items()
            if module in self.board.modules
            or (len(each) > 1 and all(set(row.given) <= {'names', 'count'} for row in each))
        }

    def _list(self, module: str, key: str) -> list[str]:
        rows = self.merged.get(module, ())
        texts = (self._resolve(row.given.get(key, '')) for row in rows)
        return [each for text in texts for each in text.split(',') if each]

    def lines(self, columns: tuple[str, str], threads: dict[str, str]) -> list[str]:
        """Return the lines that load threads with their periods, streams and modules."""
        for of in (row.given for row in self.merged.get('threads', ())):
            threads |= {of[f'name{k}']: of[f'period{k}'] for k in '123' if f'name{k}' in of}
        if len(threads) > MOST_THREADS:
            raise InterpError(f'HAL has at most {MOST_THREADS} threads, not {", ".join(threads)}')
        # HAL makes the quickest thread first.
        numbers = {name: self._resolve(period) for name, period in threads.items()}
        if all(number.isdigit() for number in numbers.values()):
            threads = dict(sorted(threads.items(), key=lambda each: int(numbers[each[0]])))
        named = ' '.join(
            f'name{k}={name} period{k}={period}'
            for k, (name, period) in enumerate(threads.items(), 1)
        )
        sums = [*self._list('weighted_sum', 'wsum_sizes'), *[str(BITS)] * columns[1].count('s')]
        found = [
            f'loadrt threads {named}',
            f'loadrt streamer depth=1000 cfg={columns[0]}',
            f'loadrt sampler depth=4000 cfg={columns[1]}',
            f'loadrt weighted_sum wsum_sizes={",".join(sums)}',
        ]
        for module in dict.fromkeys([*self.board.modules, *self.merged]):
            if module in SPECIAL:
                continue
            given = [name for row in self.merged.get(module, ()) for name in self._instances(row)]
            own = self.board.modules.get(module, [])
            line = f'loadrt {module} names={",".join([*given, *own])}'
            if module == 'bitslice':
                sizes = self._list(module, 'personality')[: len(given)]
                sizes += ['32'] * (len(given) - len(sizes)) + [str(BITS)] * len(own)
                line += f' personality={",".join(sizes)}'
            found.append(line)
        return found

    def _instances(self, row: Row) -> list[str]:
        """Return the names of the instances in a ``loadrt`` line, numbered if it has no names."""
        given, module = row.given, row.words[1].replace('_', '-')
        if 'names' in given:
            return self._resolve(given['names']).split(',')
        count = self._resolve(given.get('count', '1'))
        if not count.isdigit():
            raise InterpError(
                f'loadrt {module}: its count {count} is not known; give the INI file'
            )
        return [f'{module}.{k}' for k in range(int(count))]
