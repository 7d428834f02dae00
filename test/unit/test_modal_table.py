"""What the table declares of a modal value holds in programs, at their start, and by hand."""

import numpy as np
import pytest

from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, ProgramStream
from cnc_interp.program.execution.dialect_words import KEYS, G, M
from cnc_interp.program.modal.modal_words import MODES, SETTINGS
from cnc_interp.program.reading import MdiReader
from cnc_interp.program.text.source import Source
from cnc_interp.settings.options import Settings

GEOMETRY = Transform.of(Machine.load('xyzac'))
#: Each word that alone sets a value, with the word by which the value is shown.
SHOWN = {
    code: next(c for c, sets in MODES[name].codes.items() if sets == value)
    for code, (name, value) in SETTINGS.items()
    if name not in ('motion', 'stop_once')
}
#: For each of them, a word that sets another value.
OTHER = {
    code: next(
        c for c, sets in MODES[SETTINGS[code][0]].codes.items() if sets != SETTINGS[code][1]
    )
    for code in SHOWN
}


def stream_of(text, line=0):
    source = Source.of_text(text, 'table.nc')
    return ProgramStream(source, GEOMETRY, Settings(from_line=line, dialect='plain'))


def codes_of(text):
    """The active codes of the last block."""
    stream = stream_of(text)
    count = len(stream.read().blocks)
    return stream.modes.after(stream.modes.change_before(count - 1)).codes


@pytest.mark.parametrize('code', SHOWN)
def test_blocks_show_the_word_of_the_value(code):
    found = codes_of(f'G21 G0 X0 Y0 Z0\n{OTHER[code]}\n{code}\nG0 X5\nM30\n')
    assert SHOWN[code] in found
    assert SHOWN[OTHER[code]] not in found


@pytest.mark.parametrize('code', SHOWN)
def test_m72_brings_back_what_m70_saved(code):
    head = f'G0 X0 Y0 Z0\n{code}\n'
    changed = codes_of(f'{head}M70\n{OTHER[code]}\nG0 X3\nM72\nG0 X5\nM30\n')
    assert changed == codes_of(f'{head}G0 X5\nM30\n')


@pytest.mark.parametrize('code', SHOWN)
def test_a_start_inside_names_words_that_set_the_same_state(code):
    """The words are put before the rest of the program, which has none of its own."""
    text = f'G0 X0 Y0 Z0\n{code}\nG0 X5\nG0 X7\nM30\n'
    stream = stream_of(text, line=3)
    stream.read()
    words = '\n'.join(stream.start.found().words)
    assert codes_of(f'G0 X0 Y0 Z0\n{words}\nG0 X7\nM30\n') == codes_of(text)


@pytest.mark.parametrize('code', SHOWN)
def test_the_next_line_by_hand_has_the_value(code):
    reader = MdiReader(GEOMETRY, Settings(dialect='plain'))
    for text in (OTHER[code], code, 'G4 P0'):
        line = reader.line(text, np.zeros(5), JobSetup())
        list(line)
        reader.keep(line)
    assert SHOWN[code] in reader.modes(JobSetup()).codes


def test_an_exact_stop_of_one_block_ends_with_it():
    text = 'G0 X0\nG9 G0 X1\nG0 X2\nG0 X3\nM30\n'
    assert stream_of(text).read().blocks.exact_stop.tolist() == [False, True, False, True]


def test_no_word_of_one_value_is_missing_in_the_table_of_words():
    words = {**G, **M, **KEYS}
    assert not {code for mode in MODES.values() for code in mode.codes} - words.keys()
