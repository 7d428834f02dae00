"""Where compiled kernels are cached, and when they are compiled again.

Machine code includes the functions that a kernel calls and the constants that it reads, but numba
only compares the file of the kernel. Here a kernel is valid until its own file changes, or a file
of this package that it imports, directly or indirectly.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent
#: Folder of compiled kernels in a wheel, and the processor and its features that they need.
BROUGHT, PROCESSOR = PACKAGE / 'compiled', 'x86-64-v3'
FEATURES = {'+avx2', '+bmi', '+bmi2', '+f16c', '+fma', '+lzcnt', '+movbe'}
FOLDER = 'NUMBA_CACHE_DIR'  #: Environment variable that selects another cache folder.
IMPORT = re.compile(
    rf'^\s*(?:from|import) {PACKAGE.name}\.([\w.]+)(?: import (\([^)]*\)|[\w, ]+))?', re.M
)


@cache
def sources(file: Path) -> frozenset[Path]:
    """Return a file and all files of the package that it imports, directly or indirectly."""
    found, waiting = set[Path](), [file]
    while waiting:
        source = waiting.pop()
        if source not in found:
            found.add(source)
            waiting += _imported(source)
    return frozenset(found)


@cache
def _imported(source: Path) -> list[Path]:
    names = IMPORT.findall(source.read_text(encoding='utf-8'))
    dotted = {name for name, _ in names}
    dotted |= {f'{name}.{inner}' for name, all_ in names for inner in re.findall(r'\w+', all_)}
    places = [PACKAGE.joinpath(*name.split('.')) for name in dotted]
    files = [file for place in places for file in (Path(f'{place}.py'), place / '__init__.py')]
    return [file for file in files if file.is_file()]


@cache
def _digest(file: Path) -> bytes:
    return hashlib.sha256(file.read_bytes()).digest()


@cache
def _stamp(file: Path) -> str:
    return hashlib.sha256(b''.join(map(_digest, sorted(sources(file))))).hexdigest()


def folder() -> Path:
    """Return the cache folder of kernels: beside the sources if writable, else the user's."""
    if FOLDER in os.environ:
        return Path(os.environ[FOLDER])
    if os.access(PACKAGE, os.W_OK):
        return PACKAGE / '__pycache__' / 'kernels'
    cache_home = os.environ.get('XDG_CACHE_HOME') or str(Path.home() / '.cache')
    return Path(cache_home) / PACKAGE.name / 'kernels'


def brought(place: Path, features: Iterable[str]) -> Path | None:
    """Return the wheel's folder for a cache folder; None if its kernels cannot run here."""
    if not place.is_relative_to(folder()) or not FEATURES.issubset(features):
        return None
    return BROUGHT / place.relative_to(folder())


class KernelLocator:
    """Tells numba where the code of a kernel is cached, and whether it is still valid."""

    def __init__(self, file: Path):
        self._py_file = file  # numba names it in warnings
        self._folder = folder() / file.relative_to(PACKAGE).parent

    @classmethod
    @cache
    def of(cls, file: str) -> KernelLocator:
        return cls(Path(file).resolve())

    def ensure_cache_path(self) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return _stamp(self._py_file)

    def get_disambiguator(self) -> str:
        """Return a constant: no two functions in one file of this package have the same name."""
        return PACKAGE.name
