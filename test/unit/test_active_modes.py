"""The modal state of each block is that of its line, however the lines are read."""

import numpy as np
import pytest

from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import Blocks, JobSetup
from cnc_interp.program.blocks import block_modes as active_modes
from cnc_interp.program.reading import ProgramStream
from cnc_interp.program.text.source import Source
from cnc_interp.settings.options import Settings

PLAIN = '\n'.join(f'{"G0" if i % 3 == 0 else "G1"} X{i} F{1000 + i // 4}' for i in range(40))
PROGRAM = f"""G21 G90 G94 G54 T3 M6 S8000 M3
G0 X0 Y0 Z10
{PLAIN}
G61 M8
G2 X60 Y0 I10.5 J0
G91 G20 G1 X0.5 F20
G93 X0.5 F30
G94 G21 G90 G81 X0 Z5 R8 F300
X10
G80 G95 G1 X20 F0.1 M9
M30
"""


def modes_by_line(text, name='part.nc'):
    """The blocks, and the modal state of each."""
    transform = Transform.of(Machine.load('xyzac'))
    stream = ProgramStream(Source.of_text(text, name), transform, Settings(), JobSetup())
    blocks = Blocks.concatenate(list(stream))
    modes = stream.modes
    return blocks, [modes.after(modes.change_before(row)) for row in range(len(blocks))]


def test_each_block_has_the_modes_of_its_line():
    blocks, modes = modes_by_line(PROGRAM)
    lines = PROGRAM.splitlines()
    for row, (line, state) in enumerate(zip(blocks.line_number, modes, strict=True)):
        text = lines[line - 1]
        if row and text in PLAIN.splitlines():
            motion, _, feed = text.split()
            assert state.codes[0] == motion, text
            assert state.feedrate == pytest.approx(float(feed[1:]) / 60e3), text
            assert {'G17', 'G21', 'G90', 'G94', 'G64', 'G54', 'M3'} <= set(state.codes)
            assert (state.spindle_speed, state.tool) == (8000.0, 3)
    found = {lines[line - 1]: state for line, state in zip(blocks.line_number, modes, strict=True)}
    arc, inch = found['G2 X60 Y0 I10.5 J0'], found['G91 G20 G1 X0.5 F20']
    assert arc.codes[0] == 'G2' and {'G61', 'M8'} <= set(arc.codes)
    assert {'G1', 'G91', 'G20'} <= set(inch.codes)
    assert inch.feedrate == pytest.approx(20 * 0.0254 / 60)
    timed = found['G93 X0.5 F30']
    assert timed.duration == pytest.approx(2.0) and np.isnan(timed.feedrate)
    assert found['X10'].codes[0] == 'G81'
    turning = found['G80 G95 G1 X20 F0.1 M9']
    assert turning.feedrate == pytest.approx(1e-4)
    assert 'M9' in turning.codes and 'M8' not in turning.codes


def test_runs_of_lines_read_together_have_the_modes_of_lines_read_one_by_one():
    together = modes_by_line(PROGRAM)[1]
    apart = modes_by_line(PROGRAM.replace('\n', '\n(a comment)\n'))[1]
    assert [repr(state) for state in together] == [repr(state) for state in apart]


def test_cl_data_have_the_statements_before():
    text = 'LOADTL/4\nSPINDL/5000,RPM,CLW\nRAPID\nGOTO/0,0,10\nFEDRAT/600,MMPM\nGOTO/0,0,0\n'
    modes = modes_by_line(text + 'GOTO/9,0,0\nFINI\n', 'part.cls')[1]
    assert modes[0].codes == ('RAPID', 'UNITS/MM', 'LOADTL/4', 'SPINDL/5000,RPM,CLW')
    assert repr(modes[1]) == repr(modes[2]) and modes[1].feedrate == pytest.approx(0.01)
    assert 'RAPID' not in modes[1].codes


def test_after_very_many_changes_nothing_is_told(monkeypatch):
    monkeypatch.setattr(active_modes, 'MOST_CHANGES', 10)
    blocks, modes = modes_by_line(PROGRAM)
    known = [state is not None for state in modes]
    assert known[0] and not known[-1] and len(modes) == len(blocks)
    assert known == sorted(known, reverse=True)
    assert repr(modes[: sum(known)]) == repr(modes_by_line(PROGRAM)[1][: sum(known)])
