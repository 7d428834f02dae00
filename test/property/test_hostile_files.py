"""Files of any kind that are wrong on purpose: one line, in bounded memory, and no traceback."""

import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from plan_directories import line_x, write
from tiers import examples

from cnc_interp.cam.surface_file import read_part
from cnc_interp.core import InterpError
from cnc_interp.machine_model.machine import Machine, machines_directory
from cnc_interp.program.job import JobSetup
from cnc_interp.proof.plan_files import Stored, read_plan
from cnc_interp.proof.verify import verify

ROOT = Path(__file__).parents[2]
MUTANTS = examples(50, 10_000)
MACHINE = Machine.load('xyzac')
SETUP = (
    'work_offsets:\n  G54: {X: 1, Y: 2.5, Z: -3}\ntools:\n  T1: 80.5\n'
    'reference_points: {G28: {X: 0}}\n'
)
#: Words that mutations put in.
WORDS = (
    b'\x00',
    b'nan',
    b'-1',
    b'1e999',
    b'*a',
    b'&a [',
    b'{',
    b']',
    b'null',
    b'"',
    b'\xff',
    b': ',
    b'9' * 400,
    b'!!python/object:os.system',
    b'true',
    b'2001-99-99',
    b'[[[[[[[[',
    b'\n',
    b'0',
)


def mutant(content, rng):
    """Return bytes with some cut, doubled, exchanged or replaced."""
    content = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        at, length = int(rng.integers(0, len(content) + 1)), int(rng.integers(1, 30))
        match rng.integers(0, 5):
            case 0:
                del content[at : at + length]
            case 1:
                content[at:at] = content[at : at + length]
            case 2:
                content[at : at + length] = WORDS[int(rng.integers(len(WORDS)))]
            case 3:
                content[at:at] = WORDS[int(rng.integers(len(WORDS)))]
            case _:
                content[at : at + 1] = bytes([int(rng.integers(256))])
    return bytes(content)


def refused(read, *arguments):
    """Return the refusal of a file, a line for a mistake, '' if it is accepted."""
    with np.errstate(all='ignore'):
        try:
            read(*arguments)
        except InterpError as refusal:
            lines = str(refusal).splitlines()  # a machine file has one for each mistake
            assert (len(lines) == 1 or read == Machine.load) and max(map(len, lines)) < 2000
            return str(refusal)
    return ''


SMALL = {
    'machine': ((machines_directory() / 'xyzac.yaml').read_bytes(), '.yaml', Machine.load),
    'setup': (SETUP.encode(), '.yaml', JobSetup.load),
    'surface': ((ROOT / 'examples' / 'bumps.json').read_bytes(), '.json', read_part),
}


@pytest.mark.parametrize('kind', SMALL)
def test_mutated_small_files(kind, tmp_path):
    content, suffix, read = SMALL[kind]
    file, rng, found = tmp_path / f'a{suffix}', np.random.default_rng(19), 0
    for _ in range(MUTANTS):
        file.write_bytes(mutant(content, rng))
        found += bool(refused(read, file))
    assert found > MUTANTS // 3


@pytest.mark.parametrize('name', ['setpoints.npz', 'path.npz', 'blocks.npz', 'summary.json'])
def test_mutated_plans(name, tmp_path):
    content = line_x(MACHINE)
    for file in ('setpoints', 'path'):  # few rows, so that a mutation meets a header
        content[file] = {
            key: column[:, :9] if key.startswith('cell') else column[:10]
            for key, column in content[file].items()
        }
    folder = write(tmp_path / 'plan', content)
    sound, rng, found = (folder / name).read_bytes(), np.random.default_rng(20), 0
    for _ in range(MUTANTS):
        (folder / name).write_bytes(mutant(sound, rng))
        found += bool(refused(lambda: verify(read_plan(folder), MACHINE)))
    assert found > MUTANTS // 10


@pytest.mark.parametrize('kind', SMALL)
@pytest.mark.parametrize(
    'hostile',
    [
        'a: &a [1,1,1,1,1,1,1,1,1]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a,*a]\nlimits: [*b,*b,*b,*b]\n',
        '[' * 50_000,
        '{"a":' * 3000,
        'a: ' + '9' * 100_000,
        'x' * (1 << 25),
        '\x00',
        '',
        '- 1',
        '7',
        'limits: 5',
        'rotary: [1, 2]\nlimits: {}',
        'rotary: {primary: 4}\nlimits: {}',
        'extra: 3\nlimits: {}',
        'name: [1]\nlimits: {X: 1}',
        '{1: 2}',
        '? [a]\n: b',
    ],
)
def test_hostile_small_files(kind, hostile, tmp_path):
    _, suffix, read = SMALL[kind]
    file = tmp_path / f'a{suffix}'
    file.write_text(hostile)
    if kind == 'setup' and hostile == '':
        return
    assert refused(read, file)


@pytest.mark.parametrize('kind', SMALL)
def test_devices_and_folders_are_no_files(kind, tmp_path):
    _, suffix, read = SMALL[kind]
    for target in ('/dev/zero', '/dev/null', tmp_path):
        link = tmp_path / f'a{suffix}'
        link.unlink(missing_ok=True)
        link.symlink_to(target)
        assert refused(read, link)


def archive_of(folder, header, body=b'', method=zipfile.ZIP_STORED):
    """Replace a column of the setpoints by one with this header and content."""
    with zipfile.ZipFile(folder / 'setpoints.npz') as old:
        rest = {name: old.read(name) for name in old.namelist() if name != 's.npy'}
    with zipfile.ZipFile(folder / 'setpoints.npz', 'w', method) as new:
        for name, content in rest.items():
            new.writestr(name, content)
        text = header.encode().ljust(117) + b'\n'
        new.writestr('s.npy', b'\x93NUMPY\x01\x00' + len(text).to_bytes(2, 'little') + text + body)


@pytest.mark.parametrize(
    'shape', ['(10000000000000,)', '(-5,)', '(1,' + '1000,' * 9 + ')', '(2,)']
)
def test_lengths_are_not_believed(shape, tmp_path):
    folder = write(tmp_path, line_x(MACHINE))
    archive_of(folder, f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}")
    assert 'setpoints.npz: cannot be read' in refused(read_plan, folder)


def test_a_zip_bomb_is_not_unpacked(tmp_path):
    folder = write(tmp_path, line_x(MACHINE))
    rows = 1 << 25
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({rows},), }}"
    archive_of(folder, header, bytes(8 * rows), zipfile.ZIP_DEFLATED)
    assert 'would unpack to' in refused(read_plan, folder)


def test_compressed_columns_are_read_in_chunks(tmp_path):
    """They are unpacked to temporary files; the memory does not grow with the motion."""
    plain = read_plan(write(tmp_path / 'plain', line_x(MACHINE)))
    folder = write(tmp_path / 'packed', line_x(MACHINE))
    for name, columns in (('setpoints', plain.setpoints), ('path', plain.path)):
        arrays = {key: np.asarray(column) for key, column in columns.items()}
        np.savez_compressed(folder / f'{name}.npz', **arrays)
    packed = read_plan(folder)
    for columns, wanted in ((packed.setpoints, plain.setpoints), (packed.path, plain.path)):
        for name, column in columns.items():
            assert isinstance(column, Stored)
            np.testing.assert_array_equal(np.asarray(column), np.asarray(wanted[name]))
    assert verify(packed, MACHINE).ok


@pytest.mark.parametrize('name', ['setpoints.npz', 'path.npz', 'blocks.npz', 'summary.json'])
def test_devices_in_a_plan(name, tmp_path):
    folder = write(tmp_path / 'plan', line_x(MACHINE))
    for target in ('/dev/zero', '/dev/null', tmp_path, tmp_path / 'nowhere'):
        (folder / name).unlink()
        (folder / name).symlink_to(target)
        assert f'{name}: cannot be read' in refused(read_plan, folder)


def test_a_deep_summary(tmp_path):
    folder = write(tmp_path, line_x(MACHINE))
    (folder / 'summary.json').write_text('{"a":' * 100_000)
    assert 'nested too deep' in refused(read_plan, folder)
    (folder / 'summary.json').write_text(json.dumps({'flank_height': 10**400}))
    assert refused(read_plan, folder)
    shutil.rmtree(folder)
