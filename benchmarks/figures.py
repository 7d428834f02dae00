"""Measured figures, stored in ``out/benchmarks`` with the place where they were measured."""

from __future__ import annotations

import json
import os
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / 'out' / 'benchmarks'

Figures = dict[str, Any]


def commit() -> str:
    """Name the commit that is measured, with a plus if files differ from it."""

    def git(*words: str) -> str:
        found = subprocess.run(['git', *words], cwd=ROOT, capture_output=True, text=True)
        return found.stdout.strip()

    changed = git('status', '--porcelain', '--untracked-files=no', 'cnc_interp')
    return (git('rev-parse', '--short', 'HEAD') or 'unknown') + ('+' if changed else '')


def load(section: str) -> dict[str, Figures]:
    """Return the figures of a section by name, in the order measured; none if none are there."""
    file = FOLDER / f'{section}.json'
    return json.loads(file.read_text(encoding='utf-8')) if file.exists() else {}


def save(section: str, name: str, figures: Figures) -> None:
    """Keep the figures of one path or program, with the commit and the machine's load."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    held = load(section)
    held[name] = {**figures, 'commit': commit(), 'load': os.getloadavg()[0]}
    text = json.dumps(held, indent=1)
    (FOLDER / f'{section}.json').write_text(text + '\n', encoding='utf-8')


def forget(section: str) -> None:
    """Drop the figures of a section."""
    (FOLDER / f'{section}.json').unlink(missing_ok=True)


def where(held: dict[str, Figures]) -> str:
    """Say of which commit figures are, and how loaded the machine was."""
    commits = ', '.join(dict.fromkeys(each['commit'] for each in held.values()))
    loads = [each['load'] for each in held.values()]
    return (
        f'Commit {commits}; load {min(loads):.0f} to {max(loads):.0f} on {os.cpu_count()} cores.'
    )


def column(held: dict[str, Figures], key: str) -> np.ndarray:
    """Return one figure of all paths, nan where there is none."""
    return np.array([np.nan if each[key] is None else each[key] for each in held.values()])


class Stopwatch:
    """CPU seconds of this process: other work on the machine does not count."""

    def __init__(self) -> None:
        self._start = time.process_time()

    def seconds(self) -> float:
        """Return the CPU seconds since the start."""
        return time.process_time() - self._start
