"""Lines by hand (MDI): single lines of G-code that share one modal state.

A line starts where the machine stands. A line that is refused changes nothing.
"""

from __future__ import annotations

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import ProgramError
from cnc_interp.machine_model.transform import Transform
from cnc_interp.program.active_modes import ActiveModes
from cnc_interp.program.control_profiles import PLAIN, PROFILES, as_on
from cnc_interp.program.gcode import GcodeReader
from cnc_interp.program.job import JobSetup
from cnc_interp.program.notices import Notices
from cnc_interp.program.reading import ProgramStream
from cnc_interp.program.source import Source
from cnc_interp.settings.options import Settings

MDI = 'MDI'  #: Name of a line in messages.


class MdiLine(ProgramStream):
    def __init__(self, reader: GcodeReader, notices: Notices):
        self._source, self.source, self.dialect = reader.flow.main, MDI, 'gcode'
        self._reader = self.reader = reader
        self._notices, self.read_as = notices, ()
        self._signals = reader.mover.geometry.machine.signals


class MdiReader:
    def __init__(self, geometry: Transform, settings: Settings):
        self._geometry, self._settings = geometry, as_on(geometry, settings)
        self._last = self._reader('', Notices(), JobSetup())

    def line(self, text: str, stands: FloatArray, setup: JobSetup) -> MdiLine:
        """Begin to read a line; the machine ``stands`` there, (n_axes,) [m, rad]."""
        if len(text.splitlines()) != 1:
            raise ProgramError('give one line at a time; a program is run with run_program', MDI)
        notices = Notices()
        reader = self._reader(text, notices, setup)
        reader.follow(self._last)
        reader.stand_at(stands)
        reader.waits_at_probes = True
        return MdiLine(reader, notices)

    def keep(self, line: MdiLine) -> None:
        self._last = line.reader
        if line.reader.finished:
            self._last = self._reader('', Notices(), JobSetup())

    def _reader(self, text: str, notices: Notices, setup: JobSetup) -> GcodeReader:
        source = Source.of_text(text, MDI)
        dialect = PROFILES.get(self._settings.dialect, PLAIN)
        reader = GcodeReader(self._geometry, self._settings, setup, source, notices, dialect)
        reader.whole = False
        return reader

    def modes(self, setup: JobSetup) -> ActiveModes:
        return self._last.active_modes(setup.offset, setup.tool)
