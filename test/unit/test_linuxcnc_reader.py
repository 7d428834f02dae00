"""What of LinuxCNC's reader needs no LinuxCNC: what it is not asked to read."""

import pytest
from processor_time import bounded_processor_time

from cnc_interp.proof.linuxcnc_reader import LinuxCNCError, read_by_linuxcnc


@pytest.mark.parametrize(
    ('line', 'words'),
    [
        ('G41 D1', 'another place'),
        ('N7 G1 g042X3', 'another place'),
        ('G 41.2 D1', 'normals'),
        ('X1\ncut3df', 'normals'),
        ('G1 X1 (G41 is not used)', None),
        ('X4 ; g41.2', None),
        ('G410 X1', None),
        ('#<_my_g41>=3', None),
    ],
)
def test_compensation_is_found_anywhere_in_a_large_program(line, words, monkeypatch):
    """A search that begins anew at each line would take minutes here; this one takes 0.3 s."""
    monkeypatch.setenv('RS274', '/bin/true')
    many = 100_000 if line == 'N7 G1 g042X3' else 100
    text = 'G1 X1.25 Y-2.5 Z3 F1000\n' * many + line
    with bounded_processor_time(10.0):
        motions = read_by_linuxcnc(text, ('X', 'Y', 'Z'), False, 100)
        if words is None:
            assert not list(motions)
        else:
            with pytest.raises(LinuxCNCError, match=words):
                list(motions)
