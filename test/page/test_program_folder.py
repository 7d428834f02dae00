"""The folder of programs that a page sees, and macros of a machine file."""

import pytest

from cnc_interp.core import InterpError, MachineError
from cnc_interp.machine_model.machine_entries import Macro, macros
from cnc_interp.page.program_folder import MOST_RECENT, ProgramFolder


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_STATE_HOME', str(tmp_path / 'state'))
    programs = tmp_path / 'programs'
    (programs / 'jobs').mkdir(parents=True)
    (programs / 'old.ngc').write_text('M30\n')
    (programs / 'jobs' / 'NEW.NC').write_text('G0 X1\n')
    (programs / 'picture.png').write_text('no program')
    (programs / '.hidden.ngc').write_text('M30\n')
    (tmp_path / 'outside.ngc').write_text('M30\n')
    return ProgramFolder(programs)


def test_programs_are_listed_the_last_changed_one_first(folder):
    assert {one.name for one in folder.listed()} == {'old.ngc', 'jobs/NEW.NC'}
    folder.save('old.ngc', 'M2\n')
    assert [one.name for one in folder.listed()] == ['old.ngc', 'jobs/NEW.NC']
    assert folder.read('old.ngc') == 'M2\n'


@pytest.mark.parametrize(
    'name', ['../outside.ngc', '/etc/passwd', 'jobs/../../outside.ngc', '', ' ', '.']
)
def test_nothing_outside_the_folder_is_read_or_written(folder, name, tmp_path):
    (folder.folder / 'link.ngc').symlink_to(tmp_path / 'outside.ngc')
    for bad in (name, 'link.ngc'):
        with pytest.raises(InterpError, match='below'):
            folder.read(bad)
        with pytest.raises(InterpError, match='below'):
            folder.save(bad, 'G0 X1')
    assert (tmp_path / 'outside.ngc').read_text() == 'M30\n'


def test_what_was_opened_last_is_known_after_a_restart(folder):
    for k in range(MOST_RECENT + 3):
        folder.save(f'part_{k}.ngc', 'M30\n')
        folder.opened(f'part_{k}.ngc')
    folder.opened('old.ngc')
    folder.opened('part_9.ngc')
    (folder.folder / 'part_12.ngc').unlink()
    again = ProgramFolder(folder.folder).recent()
    assert again[:3] == ['part_9.ngc', 'old.ngc', 'part_11.ngc']
    assert 'part_12.ngc' not in again and len(again) == MOST_RECENT - 1


def test_only_names_of_programs_are_written(folder):
    with pytest.raises(InterpError, match='end the name'):
        folder.save('run.sh', 'rm -rf /')


@pytest.mark.parametrize(
    ('lines', 'moves'),
    [
        (['S3000 M3', 'G4 P60', 'M5'], False),
        (['M8'], False),
        (['m100'], False),
        (['M6'], True),
        (['T5 M6'], True),
        (['M98 P100'], True),
        (['G53 G0 Z0'], True),
        (['M8', 'X10'], True),
        (['O<warm_up> CALL'], True),
        (['#1=5'], True),
        (['G28'], True),
    ],
)
def test_a_macro_that_may_move_asks_first(lines, moves):
    assert Macro('any', tuple(lines)).moves is moves


def test_macros_of_a_machine_file_are_read_or_refused():
    told = macros({'macros': {'flood': 'M8', 'park': ['M5', ' G53 G0 Z0 ']}})
    assert told == (Macro('flood', ('M8',)), Macro('park', ('M5', 'G53 G0 Z0')))
    assert macros({}) == ()
    for wrong in ([], {'a': []}, {'a': [1]}, {'a': ''}, {'a': 'M8\nM9'}, {'a': ['M8'] * 50}):
        with pytest.raises(MachineError, match='macros'):
            macros({'macros': wrong or [1]})
