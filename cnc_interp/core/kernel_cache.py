"""
The folder of compiled kernels; each version of the sources has its own folder.

numba compares only the file of a kernel with its cache, not the files of the kernels it calls.
Without separate folders, a change in one file would leave callers with the old code.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Mapping, MutableMapping
from pathlib import Path

PREFIX = 'kernels-'


def fingerprint(package: Path) -> str:
    """Return a short hash of all source files in the package that contain kernels."""
    digest = hashlib.sha256()
    for source in sorted(package.rglob('*.py')):
        text = source.read_bytes()
        if b'njit' in text:
            digest.update(text)
    return digest.hexdigest()[:16]


def base_folder(package: Path, environment: Mapping[str, str]) -> Path:
    """Return a writable folder: next to the sources if possible, else in the user's cache."""
    if os.access(package, os.W_OK):
        return package / '__pycache__'
    cache = environment.get('XDG_CACHE_HOME') or str(Path.home() / '.cache')
    return Path(cache) / 'cnc_interp'


def choose(package: Path, environment: MutableMapping[str, str]) -> None:
    """
    Set numba's cache folder for these sources, unless the user has set one.

    Folders of older sources are removed.
    """
    if 'NUMBA_CACHE_DIR' in environment:
        return
    base = base_folder(package, environment)
    folder = base / (PREFIX + fingerprint(package))
    if not folder.is_dir():
        for old in base.glob(PREFIX + '*'):
            shutil.rmtree(old, ignore_errors=True)
    environment['NUMBA_CACHE_DIR'] = str(folder)
