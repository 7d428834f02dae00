"""Convert part programs or MDI lines to blocks: detect the dialect, and create its reader."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from cnc_interp.core import FloatArray, ProgramError, RefusedLinesError
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.blocks.block_modes import ActiveModes, ModesOfBlocks
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.program.blocks.start_line import StartLine
from cnc_interp.program.blocks.targets import ProgramChange
from cnc_interp.program.execution.context import Execution
from cnc_interp.program.job import JobSetup, Tool
from cnc_interp.program.motion.probing import Probe
from cnc_interp.program.notices import NAMED_ALONE, Notices
from cnc_interp.program.readers.cl_data import ClReader
from cnc_interp.program.readers.gcode import GcodeReader
from cnc_interp.program.readers.heidenhain import HeidenhainReader
from cnc_interp.program.readers.poses import PoseReader
from cnc_interp.program.readers.program_reader import ProgramReader
from cnc_interp.program.text import control_traits as profiles
from cnc_interp.program.text.source import Source
from cnc_interp.settings.options import Settings

_NO_PROGRAM = (
    'no line of it begins like G-code, CL data, poses or Heidenhain plain text; '
    'give a part program'
)
MDI = 'MDI'  #: Name of MDI lines in messages.


@dataclass(frozen=True)
class Program:
    blocks: Blocks  #: Row 0 is the start pose. Each other row is one linear piece of motion.
    #: Words that had no effect or were simplified, each with its first line.
    notices: tuple[str, ...] = ()
    source: str = '<blocks>'  #: File name, or ``<text>``.
    dialect: str = ''  #: Dialect of the text.


class ProgramStream:
    """A part program of any length, which is read while its blocks are taken.

    Iteration yields batches of blocks, the start pose first, or raises ProgramError.
    """

    def __init__(
        self,
        source: Source,
        geometry: Transform,
        settings: Settings,
        setup: JobSetup | None = None,
    ):
        setup = JobSetup.of(settings) if setup is None else setup
        self._source, self.source = source, source.name
        #: Text of the setup at the start; empty if nothing is set.
        self.setup = '' if setup == JobSetup() else setup.text()
        self.dialect = profiles.form_of(source)
        self._notices, self._signals = Notices(), geometry.machine.signals
        self._reader: ClReader | ProgramReader
        settings = profiles.as_on(geometry, settings)
        #: The chosen dialect, and the reason, in one line each.
        self.read_as: tuple[str, ...] = ()
        if of_points := {'cl': ClReader, 'poses': PoseReader}.get(self.dialect):
            self._reader = of_points(geometry, settings, source, self._notices)
            if setup.work_offsets or setup.g92_on:
                why = 'it runs from the workpiece zero of the machine file'
                named = 'CL data' if self.dialect == 'cl' else 'poses'
                self._notices.once('offsets', 1, f'{named}: work offsets do not count; {why}')
        else:
            kind: type[ProgramReader] = HeidenhainReader
            profile, why = profiles.HEIDENHAIN, 'by BEGIN PGM'
            if self.dialect == 'gcode':
                kind, (profile, why) = GcodeReader, profiles.dialect_of(source, settings.dialect)
            self.read_as = (f'read as {profile.title}: {why}',)
            at = Execution(geometry, settings, setup, source, self._notices, profile)
            self._reader = kind(at)
            if kind is HeidenhainReader:
                self._reader.of_macro = GcodeReader(at)

    def __iter__(self) -> Iterator[Blocks]:
        try:
            yield from self._reader.blocks()
        except RefusedLinesError as refused:
            if len(refused.errors) > NAMED_ALONE and not profiles.is_program(self._source):
                raise ProgramError(_NO_PROGRAM, self.source) from None
            raise
        finally:
            if self.probe is None:
                self._source.close()

    def read_live(self) -> None:
        """Read for a live run: it pauses at each probe until ``go_on``; tools must be known."""
        if isinstance(self._reader, ProgramReader):
            self._reader.at.is_live = True

    @property
    def probe(self) -> Probe | None:
        return self._reader.at.probe if isinstance(self._reader, ProgramReader) else None

    def go_on(self, stands: FloatArray, at: FloatArray | None) -> None:
        """Continue after a probe at the next iteration; block 0 is the current position.

        ``stands``, ``at`` (n_axes,): current positions of the axes, and positions at the answer of
        the probe, or None if it did not answer [m, rad].
        """
        assert isinstance(self._reader, ProgramReader)
        self._reader.at.go_on(stands, at)

    def close(self) -> None:
        self._source.close()

    @property
    def notices(self) -> tuple[str, ...]:
        return self._notices.texts()

    def note(self, notice: tuple[int, str] | None) -> None:
        if notice is not None:
            self._notices.once('path', *notice)

    @property
    def start(self) -> StartLine:
        return self._reader.targets.start

    @property
    def waits_first(self) -> bool:
        return self._reader.targets.waits_first

    @property
    def functions(self) -> Functions:
        """Return the functions for a run from the start line; complete after the last block."""
        functions = Functions.of_rows(self._reader.targets.functions)
        row = self.start.row
        if row is None or not self.start.line:
            return functions
        return functions.from_row(row, self._signals)

    @property
    def changes(self) -> tuple[ProgramChange, ...]:
        return tuple(self._reader.targets.changes)

    @property
    def modes(self) -> ModesOfBlocks:
        return self._reader.targets.modes

    @property
    def used(self) -> frozenset[str]:
        return frozenset(self._reader.used)

    @property
    def share(self) -> float:
        """Return the approximate share of the text whose blocks have been returned, 0 to 1."""
        return self._reader.share

    def read(self) -> Program:
        blocks = Blocks.concatenate(list(self))
        return Program(blocks, self.notices, self.source, self.dialect)


def open_program(
    path: Path,
    geometry: Transform,
    settings: Settings,
    setup: JobSetup | None = None,
    folders: Sequence[str] | None = None,
) -> ProgramStream:
    return ProgramStream(Source.of_file(path, folders), geometry, settings, setup)


def read_program(
    path: Path,
    geometry: Transform,
    settings: Settings | None = None,
    setup: JobSetup | None = None,
) -> Program:
    """Read a whole part program, or raise ProgramError with file and line of rejected words.

    Feedrate and tolerances of the settings are defaults for the program. Without ``setup``, the
    file named by the settings is read.
    """
    return open_program(path, geometry, settings or Settings(), setup).read()


def read_text(
    text: str,
    source: str,
    geometry: Transform,
    settings: Settings | None = None,
    setup: JobSetup | None = None,
) -> Program:
    """Read a program from a text, as ``read_program`` does; ``source`` names it in messages."""
    stream = ProgramStream(Source.of_text(text, source), geometry, settings or Settings(), setup)
    return stream.read()


class MdiLine(ProgramStream):
    def __init__(self, reader: GcodeReader, notices: Notices):
        self._source, self.source, self.dialect = reader.flow.main, MDI, 'gcode'
        self._reader = self.reader = reader
        self._notices, self.read_as = notices, ()
        self._signals = reader.at.signals


class MdiReader:
    """Reads MDI lines, which share one modal state; a rejected line changes nothing."""

    def __init__(self, geometry: Transform, settings: Settings):
        self._geometry, self._settings = geometry, profiles.as_on(geometry, settings)
        self._last = self._reader('', Notices(), JobSetup())

    def line(self, text: str, stands: FloatArray, setup: JobSetup) -> MdiLine:
        """Begin to read a line; ``stands`` (n_axes,): current positions of the axes [m, rad]."""
        if len(text.splitlines()) != 1:
            raise ProgramError('give one line at a time; a program is run with run_program', MDI)
        notices = Notices()
        reader = self._following(text, notices, setup)
        reader.at.stand_at(stands)
        reader.at.is_live = True
        return MdiLine(reader, notices)

    def keep(self, line: MdiLine) -> None:
        self._last = line.reader
        if line.reader.at.finished:
            self._last = self._reader('', Notices(), JobSetup())

    def _reader(self, text: str, notices: Notices, setup: JobSetup) -> GcodeReader:
        source = Source.of_text(text, MDI)
        dialect = profiles.PROFILES.get(self._settings.dialect, profiles.PLAIN)
        at = Execution(self._geometry, self._settings, setup, source, notices, dialect)
        at.whole = False
        return GcodeReader(at)

    def modes(self, setup: JobSetup) -> ActiveModes:
        reader = self._following('', Notices(), setup)
        reader.at.mover.aim()
        return reader.active_modes(setup.offset, setup.tool)

    def _following(self, text: str, notices: Notices, setup: JobSetup) -> GcodeReader:
        """Return a reader that continues from the current modal state.

        Until G43 or G49 changes it, the length of the tool in the spindle is in effect; with
        tool-tip programming, that of the machine file.
        """
        reader = self._reader(text, notices, setup)
        reader.at.follow(self._last.at)
        mover, tool = reader.at.mover, setup.tools.get(setup.tool, Tool())
        if not mover.frames.names_length and mover.dialect is not profiles.LINUXCNC:
            mover.frames.length = 0.0 if mover.tcp else tool.worn.length
        return reader
