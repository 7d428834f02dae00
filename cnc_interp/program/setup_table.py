"""SetupTable: the setup of the machine, kept in its file, and the log of its changes."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TextIO

from cnc_interp.core.errors import InterpError
from cnc_interp.core.small_files import LONGEST_YAML, write_whole
from cnc_interp.program.job import JobSetup, SetupChange


class SetupTable:
    """Offsets and tools of the machine.

    A change is in the log (``.log`` beside the file) first, then in the file, then here. While it
    is open, no other table can keep the same file. The file need not be there yet; without one
    nothing outlives this object.
    """

    def __init__(self, file: Path | None):
        self.file = file
        self.changed_by = self.change = ''  #: The last change: who made it, and what it was.
        self._log: TextIO | None = None
        self.setup = JobSetup()
        if file is None:
            return
        try:
            log = file.resolve()
            log.parent.mkdir(parents=True, exist_ok=True)
            self._log = log.with_name(f'{log.name}.log').open('a', encoding='utf-8')
            fcntl.flock(self._log, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InterpError(f'{file}: another program_node keeps its offsets there') from None
        except OSError as problem:
            raise InterpError(f'{file}: no log beside it: {problem.strerror}') from None
        if file.exists():
            self.setup = JobSetup.load(file)

    def apply(self, changes: Sequence[SetupChange], who: str) -> str:
        """Change all of it, or raise InterpError; return what was changed, or ''."""
        after = self.setup
        for change in changes:
            after = after.changed(change)
        text = after.text()
        after = JobSetup.of_text(text)  # what a restart will read, to the last digit
        names = {(change.field, change.key): change for change in changes}.values()
        told = '; '.join(
            f'{change.name}: {self.setup.told(change)} -> {after.told(change)}'
            for change in names
            if self.setup.told(change) != after.told(change)
        )
        if after == self.setup:
            return ''
        if len(text.encode()) > LONGEST_YAML:
            raise InterpError(f'the tool table is full ({LONGEST_YAML >> 10} kB); remove tools')
        who = ' '.join(who.split()) or 'unknown'
        try:
            self._write_log(f'{who}\t{told}')
            if self.file is not None:
                write_whole(self.file, text)
        except OSError as problem:
            self._write_log(f'{who}\tnot changed: {problem.strerror}')
            raise InterpError(f'{self.file}: cannot be written: {problem.strerror}') from None
        self.setup, self.changed_by, self.change = after, who, told
        return told

    def _write_log(self, words: str) -> None:
        if self._log is None:
            return
        self._log.write(f'{datetime.now().astimezone().isoformat()}\t{words}\n')
        self._log.flush()
        os.fsync(self._log.fileno())

    def close(self) -> None:
        if self._log is not None:
            self._log.close()
