"""Files of programs: how they are named, and which other files they call."""

from __future__ import annotations

import re
from pathlib import Path

#: Suffixes of a subprogram in a file of its own, in the order in which they are tried.
SUBPROGRAM_SUFFIXES = (
    '.ngc', '.nc', '.tap', '.NC', '.TAP', '.spf', '.SPF', '.mpf', '.MPF', '.SUB', '',
)  # fmt: skip
#: Suffixes of CL data, in lower case.
CL_SUFFIXES = frozenset(('.apt', '.cl', '.cls', '.ncl', '.aptsource'))
#: Suffixes by which programs are found in a folder, in lower case.
PROGRAM_SUFFIXES = CL_SUFFIXES | {'.ngc', '.nc', '.tap', '.mpf', '.cnc', '.gcode', '.h'}
#: What may name a subprogram: ``o<name>``, or a number after O or P.
_NAME, _NUMBER = re.compile(rb'[Oo]\s*<\s*([\w-]+)\s*>'), re.compile(rb'[OoPp]\s*(\d{1,9})(?!\d)')
#: A number that is computed.
_COMPUTED = re.compile(rb'[OoPp]\s*[#\[]')


def subprogram_file(folder: Path, stem: str) -> Path | None:
    if not re.fullmatch(r'[\w-]+', stem):
        return None
    paths = (folder / (stem + suffix) for suffix in SUBPROGRAM_SUFFIXES)
    return next((path for path in paths if path.is_file()), None)


def called_files(path: Path, text: bytes) -> dict[str, bytes]:
    """Return names and contents of files beside a program that it and they may call, or more."""
    found: dict[str, bytes] = {}
    waiting = [text]
    while waiting:
        for stem in sorted(_stems(waiting.pop(), path.parent)):
            file = subprogram_file(path.parent, stem)
            if file is not None and file.name != path.name and file.name not in found:
                found[file.name] = file.read_bytes()
                waiting.append(found[file.name])
    return dict(sorted(found.items()))


def _stems(text: bytes, folder: Path) -> set[str]:
    stems = {name.decode().lower() for name in _NAME.findall(text)}
    if _COMPUTED.search(text):
        stems |= {path.stem for path in folder.glob('O[0-9]*')}
    for digits in set(_NUMBER.findall(text)):
        number = int(digits)
        # Fanuc writes the number of calls before the last four digits.
        stems |= {digits.decode(), f'O{number:04d}', f'O{number % 10_000:04d}'}
    return stems
