"""
What happens to the LinuxCNC configurations in a folder: read, made, loaded, or rejected.

    python benchmarks/linuxcnc_configs.py FOLDER [--load] [--lines]

Counts all INI files that differ in more than white space. *Read*: ``import-ini`` makes a machine
file. *Made*: ``hal`` makes a HAL file. *Loaded*: LinuxCNC's HAL accepts the whole file. To load a
file without its hardware and programs, the lines that load them are left out, and a stand-in
provides their pins. ``--lines`` shows a line for each file.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from hal_session import NOBODY, why_not

from cnc_interp.convert.linuxcnc_files import hal_lines, read_ini
from cnc_interp.convert.linuxcnc_hal import hal_file
from cnc_interp.convert.linuxcnc_ini import machine_from_ini
from cnc_interp.convert.linuxcnc_wiring import wiring_of
from cnc_interp.core import InterpError
from cnc_interp.machine_model.machine import Machine

MODULES = Path('/usr/lib/linuxcnc/modules')
#: Modules of hardware, and how their pins and functions begin where that is not their name.
HARDWARE = re.compile(
    r'hal_(parport|ppmc|gm|bb_gpio|pi_gpio|speaker)|hostmot2|hm2_\w+|opto_ac5|pluto_\w+'
)
#: What no stand-in may have: pins of the motion controller.
CONTROLLER = 'joint', 'axis', 'motion', 'spindle', 'iocontrol', 'halui'
WAIT = 60.0  #: Longest wait for a command [s].
PINS = """import sys, time, hal
components = {}
for line in open(sys.argv[1]):
    name, kind, way = line.split()
    prefix, _, rest = name.partition('.')
    if prefix not in components:
        components[prefix] = hal.component(f'stand-in-{len(components)}')
        components[prefix].setprefix(prefix)
    kind, way = (getattr(hal, f'HAL_{word.upper()}') for word in (kind, way))
    components[prefix].newpin(rest, kind, way)
for component in components.values():
    component.ready()
print('ready', flush=True)
time.sleep(600)
"""


@dataclass(frozen=True)
class Found:
    ini: Path
    reached: str  #: ``read``, ``made``, ``loaded``; empty if it was refused at once.
    why: str = ''  #: What refused it, or failed.
    refused: bool = False  #: Whether cnc_interp refused it.


def inis(folder: Path) -> Iterator[Path]:
    """Return the INI files of LinuxCNC in a folder, each once."""
    seen = set()
    for path in sorted(folder.rglob('*.ini')):
        text = path.read_text('utf-8', 'replace') if path.is_file() else ''
        key = hashlib.sha256(' '.join(text.split()).encode()).digest()
        upper = text.upper()
        if '[TRAJ]' in upper and ('[KINS]' in upper or '[EMC' in upper) and key not in seen:
            seen.add(key)
            yield path


def tried(path: Path, loads: bool) -> Found:
    reached = ''
    try:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / 'machine.yaml'
            file.write_text(machine_from_ini(path)[0], encoding='utf-8')
            machine, reached = Machine.load(file), 'read'
        ini = read_ini(path)
        wiring, _ = wiring_of(machine, ini, None, None)
        text = '\n'.join(hal_lines([path], ini))
        made, _ = hal_file(text, machine.axis_names, wiring, machine.signals)
        reached = 'made'
    except InterpError as problem:
        return Found(path, reached, ' '.join(str(problem).split()), True)
    if not loads:
        return Found(path, reached)

    def value(found: re.Match[str]) -> str:
        return ini.get(found[1].upper(), found[2].strip('()').upper()) or found[0]

    told = load(re.sub(r'\[(\w+)\](\(\w+\)|\w+)', value, made))
    return Found(path, reached, told) if told else Found(path, 'loaded')


class _Session:
    """HAL while a file is loaded."""

    def __init__(self, folder: Path):
        self.folder = folder
        root = os.geteuid() == 0
        self._user = {'user': NOBODY, 'group': NOBODY, 'extra_groups': []} if root else {}
        if root:
            os.chown(folder, NOBODY, NOBODY)

    def run(self, *command: str) -> tuple[int, str]:
        told = self.folder / 'told.txt'
        with told.open('w') as output:
            done = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                timeout=WAIT,
                env=os.environ | {'HOME': str(self.folder)},
                cwd='/',
                check=False,
                **self._user,
            )
        return done.returncode, told.read_text(errors='replace')

    def start(self, *command: str) -> subprocess.Popen[str]:
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd='/', **self._user)

    def lines(self, name: str, lines: list[str]) -> str:
        """Let halcmd take lines; return its first complaint."""
        file = self.folder / name
        file.write_text('\n'.join(lines) + '\n', encoding='utf-8')
        file.chmod(0o644)
        status, told = self.run('halcmd', '-f', str(file))
        lines = [line for line in told.splitlines() if line and not line.startswith('Note')]
        return (lines or [f'exit code {status}'])[0] if status else ''


def load(text: str) -> str:
    """Load a HAL file without its hardware; return the first complaint, empty without."""
    with tempfile.TemporaryDirectory(prefix='cnc_interp_hal_') as name:
        session = _Session(Path(name))
        stand_in = None
        try:
            rows = [line.partition('#')[0].split() for line in text.splitlines()]
            rows = [row for row in rows if row]
            loads = [row for row in rows if row[0] == 'loadrt']
            complete = all(_available(row[1]) for row in loads)
            #: Of modules that are there; the functions of others are left out with them.
            own = {name for row in loads if _available(row[1]) for name in _instances(row)}
            first = [
                r for r in rows if r[0] == 'newsig' or (r[0] == 'loadrt' and _available(r[1]))
            ]
            if told := session.lines('loads.hal', [' '.join(row) for row in first]):
                return told
            known = _shown(session, 'pin')
            functions = set(_shown(session, 'funct'))
            beginnings = {pin.split('.')[0] for pin in known} | functions
            parameters = {pin.split('.')[0] for pin in _shown(session, 'param')}
            rest, missing = [], dict[str, None]()
            for row in (r for r in rows if r[0] not in ('loadrt', 'newsig', 'loadusr', 'waitusr')):
                begins = {pin: pin.split('.')[0] for pin in row[1:] if '=' not in pin}
                if row[0] == 'net':
                    missing |= {
                        pin: None
                        for pin in row[2:]
                        if begins.get(pin) not in (None, *CONTROLLER, *beginnings)
                    }
                elif row[0] in ('setp', 'getp'):
                    if begins[row[1]] not in beginnings | parameters:
                        continue
                elif row[0] == 'addf' and not complete and not _called(row[1], functions, own):
                    continue
                rest.append(' '.join(row))
            if missing:
                file = session.folder / 'pins.txt'
                file.write_text('\n'.join(_stand_in(rows, known, list(missing))) + '\n')
                file.chmod(0o644)
                (session.folder / 'pins.py').write_text(PINS)
                (session.folder / 'pins.py').chmod(0o644)
                program = '/usr/bin/python3', str(session.folder / 'pins.py'), str(file)
                stand_in = session.start(*program)
                if stand_in.stdout is None or stand_in.stdout.readline() != 'ready\n':
                    return 'the stand-in has failed'
            return session.lines('rest.hal', rest)
        finally:
            session.run('halcmd', 'stop')
            if stand_in is not None:
                stand_in.kill()
                stand_in.wait()
            session.run('halcmd', 'unload', 'all')
            session.run('rtapi_app', 'exit')
            deadline = time.monotonic() + 10.0
            while why_not() and time.monotonic() < deadline:
                time.sleep(0.02)


def _available(module: str) -> bool:
    return not HARDWARE.fullmatch(module) and (MODULES / f'{module}.so').exists()


def _instances(row: list[str]) -> list[str]:
    given = dict(word.split('=', 1) for word in row if '=' in word)
    return [row[1], row[1].replace('_', '-'), *given.get('names', '').split(',')]


def _called(function: str, functions: set[str], own: set[str]) -> bool:
    return function in functions or function in own or function.split('.')[0] in own


def _shown(session: _Session, what: str) -> dict[str, tuple[str, str]]:
    """Return what HAL has, with type and direction."""
    _, told = session.run('halcmd', '-s', 'show', what)
    found = {}
    for row in (line.split() for line in told.splitlines()):
        if what == 'funct' and len(row) >= 6:
            found[row[-1]] = ('', '')
        elif len(row) >= 5:
            found[row[4]] = (row[1], row[2])
    return found


def _stand_in(
    rows: list[list[str]], known: dict[str, tuple[str, str]], missing: list[str]
) -> Iterator[str]:
    """Return the pins of the stand-in: of the type of those that they are connected to."""
    signals: dict[str, list[str]] = {}
    for row in (row for row in rows if row[0] == 'net'):
        signals.setdefault(row[1], []).extend(p for p in row[2:] if '=' not in p)
    set_by_hand = {row[1]: row[2] for row in rows if row[0] == 'sets' and len(row) > 2}
    types = {row[1]: row[2] for row in rows if row[0] == 'newsig' and len(row) > 2}
    for signal, pins in signals.items():
        there = [known[pin] for pin in pins if pin in known]
        is_bit = set_by_hand.get(signal, '0').upper() in ('0', '1', 'TRUE', 'FALSE')
        kind = there[0][0] if there else types.get(signal, 'bit' if is_bit else 'float')
        written, both = (any(way == each for _, way in there) for each in ('OUT', 'I/O'))
        written = written or signal in set_by_hand
        for pin in dict.fromkeys(pin for pin in pins if pin in missing):
            yield f'{pin} {kind} {"IN" if written else "IO" if both else "OUT"}'
            written = written or not both


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('folder', type=Path)
    parser.add_argument('--load', action='store_true')
    parser.add_argument('--lines', action='store_true')
    options = parser.parse_args()
    if options.load and (reason := why_not()):
        raise SystemExit(reason)
    counts, reasons = Counter[str](), Counter[str]()
    stages = ('', 'read', 'made', 'loaded')
    for path in inis(options.folder):
        found = tried(path, options.load)
        for stage in stages[: stages.index(found.reached) + 1]:
            counts[stage or 'found'] += 1
        if found.refused:
            counts['refused'] += 1
            reasons[re.sub(r'\S*/\S+: ?|[\d.]+', '', found.why)[:70]] += 1
        elif found.why:
            counts['failed'] += 1
        if options.lines:
            with suppress(ValueError):
                path = path.relative_to(options.folder)
            print(f'{found.reached or "-":7} {path}: {found.why}', flush=True)
    print('  '.join(f'{key} {value}' for key, value in counts.items()))
    for reason, count in reasons.most_common(20):
        print(f'{count:5}  {reason}')


if __name__ == '__main__':
    main()
