"""Results on the disk: one small file for each task, whole at every moment."""

from __future__ import annotations

from pathlib import Path

from cnc_interp.batch.task import Outcome, Verdict
from cnc_interp.core.small_files import UnreadableError, read_json, write_whole

#: Verdicts that another attempt may change.
UNCERTAIN = (Verdict.KILLED, Verdict.TOO_LONG, Verdict.TOO_LARGE)


class Store:
    """
    The results of a folder, by the keys of their tasks.

    Parameters
    ----------
    folder : Path
        Made if missing.

    """

    def __init__(self, folder: Path):
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def find(self, key: str) -> Outcome | None:
        """Return a result that is final; None if there is none."""
        try:
            found = Outcome.of_json(read_json(self._file(key)))
        except (OSError, UnreadableError, ValueError, TypeError, KeyError):
            return None
        return None if found.row.verdict in UNCERTAIN else found

    def keep(self, key: str, outcome: Outcome) -> None:
        """Write a result."""
        write_whole(self._file(key), outcome.to_text())

    def _file(self, key: str) -> Path:
        return self._folder / f'{key}.json'
