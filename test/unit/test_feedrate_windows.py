"""Windows of public programs whose law once did not converge, each for a reason of its own."""

from pathlib import Path

import pytest
from whole_plans import plan_program

from cnc_interp.feedrate.planning_windows import CONVERGED
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.settings.options import Settings

PROGRAMS = Path(__file__).parents[3] / 'shared' / 'programs'


@pytest.mark.skipif(not PROGRAMS.is_dir(), reason='no shared programs beside the repository')
@pytest.mark.parametrize(
    ('name', 'header', 'lines'),
    [
        # The motion begins faster than any first guess: arcs of chords passed at speed.
        ('linuxcnc-lhchips4/LHchips4.ngc', 25, (25, 1200)),
        # Each correction of one short cell took less than half of what was left to correct.
        ('linuxcnc-impeller-xyzac/impeller-7bl-xyzac.ngc', 6, (1099, 1260)),
    ],
)
def test_every_window_converges(name, header, lines):
    text = (PROGRAMS / name).read_text().splitlines()
    machine = Machine.load('xyzac')
    part = '\n'.join([*text[:header], *text[slice(*lines)], 'M2'])
    settings = Settings(feedrate=0.05)
    plan = plan_program(
        read_text(part, 'a.ngc', Transform.of(machine), settings), machine, settings
    )
    assert len(plan.pieces) > 2
    assert {piece.solved for piece in plan.pieces} == {CONVERGED}
