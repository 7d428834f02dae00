"""STEP files are read by OpenCASCADE in a process of its own, with bounds on memory and time.

It may crash, or compute without end, for a file that is wrong on purpose. Then only that process
ends, and the file is refused. It writes the surface, or a reason, to its standard output.
"""

from __future__ import annotations

import os
import pickle
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from cnc_interp.cam.step_file import Part, read_step_part
from cnc_interp.cam.surface import SurfaceError
from cnc_interp.core.small_files import BoundedMemory

#: Time of a processor for a file [s], and for each MB of it. Memory beside what its length
#: explains [bytes].
SECONDS, SECONDS_PER_MB, ROOM = 8, 2, 1 << 29


def read_step_safely(
    path: Path, faces: Sequence[int], note: Callable[[str], None] | None = None
) -> Part:
    """Read faces in a process of its own; as ``step_file.read_step_part``."""
    words = [str(path), *map(str, faces)]
    # -P: it imports this package and installed ones, and nothing from the folder of the user.
    command = [sys.executable, '-P', '-m', 'cnc_interp.cam.step_process', *words]
    given, own = os.environ.get('PYTHONPATH', ''), str(Path(__file__).parents[2])
    places = os.pathsep.join(filter(None, [given, own]))
    child = subprocess.run(
        command, env=os.environ | {'PYTHONPATH': places},
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    if child.returncode:
        raise SurfaceError(f'{path}: OpenCASCADE cannot read it: {_end(child.returncode)}')
    part, notes, refusal = pickle.loads(child.stdout)
    if note:
        for text in notes:
            note(text)
    if refusal:
        raise SurfaceError(refusal)
    read: Part = part
    return read


def _end(code: int) -> str:
    if code == -signal.SIGXCPU:
        return 'it takes longer than a file of this length may'
    return f'it ended by {signal.Signals(-code).name}' if code < 0 else f'exit code {code}'


def answer(path: Path, faces: Sequence[int]) -> tuple[Part | None, list[str], str]:
    """Read faces within bounds that stay; return them, notes, and why there are none."""
    notes: list[str] = []
    try:
        length = path.stat().st_size if path.is_file() else 0
        most = SECONDS + SECONDS_PER_MB * length // 1_000_000
        resource.setrlimit(resource.RLIMIT_CPU, (most, most + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        BoundedMemory(*[path] * (length > 0), room=ROOM)
        return read_step_part(path, faces, notes.append), notes, ''
    except SurfaceError as refusal:
        return None, notes, str(refusal)
    except MemoryError:
        return None, notes, f'{path}: it needs more memory than its length explains'
    except Exception as fault:  # bindings of OpenCASCADE raise anything
        reason = ' '.join(str(fault).split())[:200] or type(fault).__name__
        return None, notes, f'{path}: cannot be read ({reason})'


def main() -> None:
    """Read the file that the command line names, and write what was found."""
    output = os.fdopen(os.dup(1), 'wb')
    os.dup2(2, 1)  # what OpenCASCADE prints is no part of the answer
    with output:
        pickle.dump(answer(Path(sys.argv[1]), [int(word) for word in sys.argv[2:]]), output)
        output.flush()
        os._exit(0)  # destructors of OpenCASCADE may crash, too


if __name__ == '__main__':
    main()
