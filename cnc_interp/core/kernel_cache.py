"""
Where compiled kernels are kept: a folder of their own for every state of their sources.

numba looks only at the file of a kernel itself, not at those of the kernels it calls; after a
change in one file it would go on using callers compiled against the old one.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Mapping, MutableMapping
from pathlib import Path

PREFIX = 'kernels-'


def fingerprint(package: Path) -> str:
    """Return a short hash of all sources of the package that hold kernels."""
    digest = hashlib.sha256()
    for source in sorted(package.rglob('*.py')):
        text = source.read_bytes()
        if b'njit' in text:
            digest.update(text)
    return digest.hexdigest()[:16]


def base_folder(package: Path, environment: Mapping[str, str]) -> Path:
    """Return a folder that may be written: beside the sources, else in the user's cache."""
    if os.access(package, os.W_OK):
        return package / '__pycache__'
    cache = environment.get('XDG_CACHE_HOME') or str(Path.home() / '.cache')
    return Path(cache) / 'cnc_interp'


def choose(package: Path, environment: MutableMapping[str, str]) -> None:
    """
    Point numba at the folder for these sources, unless the user has chosen one.

    Folders of older sources are removed, so that they do not pile up.
    """
    if 'NUMBA_CACHE_DIR' in environment:
        return
    base = base_folder(package, environment)
    folder = base / (PREFIX + fingerprint(package))
    if not folder.is_dir():
        for old in base.glob(PREFIX + '*'):
            shutil.rmtree(old, ignore_errors=True)
    environment['NUMBA_CACHE_DIR'] = str(folder)
