"""Look for programs that a reader answers wrongly, guided by coverage; needs atheris (pip).

    python tools/fuzz_programs.py FOLDER [-max_total_time=600 ...]

FOLDER holds the programs found so far, one per file; it is begun with those of the tests. Options
with one dash are those of libFuzzer. What fails is written to ``crash-...`` beside FOLDER.
"""

from __future__ import annotations

import random
import sys
from importlib import import_module
from pathlib import Path

import atheris

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test' / 'unit'))
# Compiled code is not instrumented, and cannot be.
with atheris.instrument_imports(['cnc_interp.program'], ['cnc_interp.program.text.scan']):
    import_module('cnc_interp.program.reading')

import test_program_fuzz as programs

SEEDS = programs.seeds()
#: Bounds that no program of a few kB needs; longest program, time and memory of one of them.
BOUNDS = ['-max_len=6000', '-timeout=60', '-rss_limit_mb=2000']


def changed(text: bytes, most: int, seed: int) -> bytes:
    """Change a program: words and lines as the tests do, or bytes as libFuzzer does."""
    chance = random.Random(seed)
    if chance.random() < 0.5:
        others = SEEDS if chance.random() < 0.1 else []
        mutated: bytes = programs.mutated(chance, [text or b'G1', *others])
        return mutated[:most]
    return bytes(atheris.Mutate(text, most))


def read(text: bytes) -> None:
    """Read a program for a machine that its length chooses."""
    programs.answer(text, programs.GEOMETRIES[len(text) % 3])


def main() -> None:
    """Fuzz."""
    if len(sys.argv) < 2 or sys.argv[1].startswith('-'):
        sys.exit(__doc__)
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for number, text in enumerate(SEEDS):
        (folder / f'seed{number}').write_bytes(text)
        read(text)  # kernels are compiled
    finds = f'-artifact_prefix={folder.resolve().parent}/'
    atheris.Setup(
        [sys.argv[0], str(folder), *BOUNDS, finds, *sys.argv[2:]], read, custom_mutator=changed
    )
    atheris.Fuzz()


if __name__ == '__main__':
    main()
