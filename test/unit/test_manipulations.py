"""
Manipulated plans: what `check` must catch, and what it rightly accepts.

Each row of the table changes a sound plan in one way. It is written, and `check` reads it.
"""

import copy
import json
import re

import numpy as np
import pytest
import yaml
from plan_directories import PERIOD, files, stroke, turned_tip, write
from tiers import few_of
from whole_plans import plan_program, write_plan

from cnc_interp.commands.cli import main
from cnc_interp.core import DEG, MM, MM_PER_MIN, InterpError
from cnc_interp.machine_model.machine import Machine, machines_directory
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.proof import plan_files
from cnc_interp.proof.verify import verify_plan
from cnc_interp.settings.options import Settings

MACHINE = Machine.load('xyzac')
FEED = 3000 * MM_PER_MIN
#: A program with corners, a rotation, a stop and two feeds.
FIVE_AXES = """
TRAORI
G0 X0 Y0 Z0 A5 C0
G64 P0.02
G1 X20 A15 C10 F3000
Y12 A20
G1 X5 A8 C20 F2000
G9 X5 A12 C25
X0 Y0
"""
#: What manipulated files may say about themselves: caught by `check` with exit code 1 or 2.
CAUGHT, ACCEPTED = True, False


def plan_of(text, folder, machine=MACHINE):
    """Plan a program and write its files."""
    program = read_text(text, 'five_axes.ngc', Transform.of(machine), Settings())
    write_plan(plan_program(program, machine), folder)


@pytest.fixture(scope='module')
def sound(tmp_path_factory):
    """Files of a planned program, as arrays."""
    folder = tmp_path_factory.mktemp('sound')
    plan_of(FIVE_AXES, folder)
    content = {'summary': json.loads((folder / 'summary.json').read_text())}
    for name in ('setpoints', 'path', 'blocks'):
        with np.load(folder / f'{name}.npz') as archive:
            content[name] = {column: archive[column] for column in archive.files}
    return content


def check(folder, capsys, *options):
    """Exit code and text of `check`; a fault of the input is one line."""
    capsys.readouterr()
    code = main(['check', str(folder), *options])
    said = capsys.readouterr()
    if code == 2:
        assert said.err.count('\n') == 1, said.err
    return code, said.out + said.err


# ---------------------------------------------------------------------- values of single columns
TABLE = {}


def manipulation(name, caught, change):
    assert name not in TABLE
    TABLE[name] = (caught, change)


def column(name, caught, file, key, change):
    """Change one column of one file."""

    def change_content(content):
        old = content[file][key].copy()
        new = change(old)
        content[file][key] = old if new is None else new

    manipulation(name, caught, change_content)


def at(row, value, *axis):
    """Add a value to one row, counted as a share of the rows."""

    def change(array):
        array[(int(row * len(array)), *axis)] += value

    return change


for j, axis in enumerate(MACHINE.axis_names):
    small = 1e-7 if j < 3 else 1e-6
    for row in (0.2, 0.5, 0.8):
        column(
            f'{axis}: one setpoint off by 0.1 um or 1 urad at {row:.0%}',
            CAUGHT,
            'setpoints',
            'position',
            at(row, small, j),
        )
    column(
        f'{axis}: all setpoints off by 1 um',
        CAUGHT,
        'setpoints',
        'position',
        lambda q, j=j: q + 1e-6 * np.eye(5)[j],
    )
    column(
        f'{axis}: a slow drift of 2 um',
        CAUGHT,
        'setpoints',
        'position',
        lambda q, j=j: q + np.outer(np.linspace(0, 2e-6, len(q)), np.eye(5)[j]),
    )
    for key in ('velocity', 'acceleration'):
        column(
            f'{axis}: {key} times 2',
            CAUGHT,
            'setpoints',
            key,
            lambda v, j=j: v * (1 + np.eye(5)[j]),
        )
        column(
            f'{axis}: {key} changes its sign',
            CAUGHT,
            'setpoints',
            key,
            lambda v, j=j: v * (1 - 2 * np.eye(5)[j]),
        )
    column(f'{axis}: of the path off by 0.1 um', CAUGHT, 'path', 'q', at(0.5, 1e-7, j))
    for side in ('cell_left', 'cell_right'):
        for order, by in ((0, 1e-7), (1, 1.0), (2, 1e4)):
            column(
                f'{axis}: {side} of order {order} in one row',
                CAUGHT,
                'path',
                side,
                lambda c, j=j, order=order, by=by: (
                    c
                    + by
                    * np.eye(5)[j]
                    * (np.arange(4) == order)[:, None, None]
                    * (np.arange(c.shape[1]) == c.shape[1] // 2)[:, None]
                ),
            )
column('time begins at 1 s', CAUGHT, 'setpoints', 'time', lambda time: time + 1.0)
column(
    'a row with linear rotary axes that names no start',
    CAUGHT,
    'blocks',
    'interpolation',
    lambda kind: np.r_[kind[:2], 1, kind[3:]],
)
manipulation(
    'one setpoint of three axes moved along the tool by 1 um',
    CAUGHT,
    lambda content: at(0.5, 1e-6, slice(0, 3))(content['setpoints']['position']),
)
for name, change in {
    'one late setpoint': at(0.5, 0.1 * PERIOD),
    'a slower clock': lambda t: t * 1.01,
    'a pause in the clock': lambda t: t + PERIOD * (np.arange(len(t)) > len(t) // 2),
    'time runs backwards': lambda t: t[::-1].copy(),
}.items():
    column(f'time: {name}', CAUGHT, 'setpoints', 'time', change)
for name, change in {
    'all of row 1': lambda b: np.ones_like(b),
    'all of the last row': lambda b: np.full_like(b, b[-1]),
    'backwards': lambda b: b[::-1].copy(),
    'one row of the motion is named by nobody': lambda b: np.where(b == b[len(b) // 2], b[0], b),
    'three rows too late': lambda b: np.maximum(b - 3, b[0]),
    'three rows too early': lambda b: np.minimum(b + 3, b[-1]),
    'one sample of the first row at the end': lambda b: np.r_[b[:-1], b[:1]],
}.items():
    column(f'block: {name}', CAUGHT, 'setpoints', 'block', change)
for name, change in {
    'times 1.001': lambda s: s * 1.001,
    'off by 1 um': lambda s: s + 1e-6,
    'one value': at(0.5, 1e-6),
    'all zero': lambda s: 0 * s,
    'backwards': lambda s: s[::-1].copy(),
}.items():
    column(f's: {name}', CAUGHT, 'setpoints', 's', change)
    column(f's of the path: {name}', CAUGHT, 'path', 's', change)
for key in ('tip', 'axis'):
    column(f'{key} of the path: one row', CAUGHT, 'path', key, at(0.5, 1e-6, 1))
for name, change in {
    'times 1.01': lambda f: f * 1.01,
    'one row': at(0.5, 0.001),
    'NaN': lambda f: f * np.nan,
    'zero': lambda f: 0 * f,
    'times 0.99': lambda f: f * 0.99,
}.items():
    for key in ('feed', 'feed_limit'):
        column(f'{key} of the path: {name}', CAUGHT, 'path', key, change)


def faster_program(content):
    """Say that the path was programmed faster, with the limit of Eq. 10 that belongs to it."""
    path = content['path']
    path['programmed_feed'] = 1.2 * path['programmed_feed']
    bound = path['programmed_feed'].copy()
    for cells, side in ((path['cell_left'], np.s_[:-1]), (path['cell_right'], np.s_[1:])):
        for k, limits in enumerate(MACHINE.limits.by_order, start=1):
            with np.errstate(divide='ignore'):
                reach = (limits / np.abs(cells[k])) ** (1.0 / k)
            bound[side] = np.minimum(bound[side], reach.min(axis=1))
    path['feed_limit'] = bound


manipulation('programmed feed of the path: higher than the program says', CAUGHT, faster_program)
column('stop of the path: none', CAUGHT, 'path', 'stop', lambda stop: stop & False)
column('stop of the path: everywhere', CAUGHT, 'path', 'stop', lambda stop: stop | True)
column('block of the path: all of row 1', CAUGHT, 'path', 'block', np.ones_like)
column(
    'block of the path: one row later', CAUGHT, 'path', 'block', lambda b: np.minimum(b + 2, b[-1])
)


def cut_path(rows):
    def change(content):
        path = content['path']
        for key, values in path.items():
            if key.startswith('cell'):
                path[key] = values[:, rows(values.shape[1])]
            else:
                kept = rows(len(values) - 1)
                path[key] = np.concatenate([values[:-1][kept], values[-1:]])

    return change


manipulation('the path cut to two rows', CAUGHT, cut_path(lambda n: slice(0, 1)))
manipulation('half of the path', CAUGHT, cut_path(lambda n: slice(0, n // 2)))
manipulation('one row of the path missing', CAUGHT, cut_path(lambda n: np.arange(n) != n // 2))

# ---------------------------------------------------------------------- the program and its words
for name, value in (('NaN', np.nan), ('negative', -1.0), ('zero', 0.0), ('endless', np.inf)):
    column(
        f'feed: {name} in one block',
        CAUGHT,
        'blocks',
        'feed',
        lambda f, value=value: np.where(np.arange(len(f)) == 3, value, f),
    )
    for kind in ('contour', 'orientation'):
        column(
            f'{kind} tolerance: {name} in one block',
            CAUGHT,
            'blocks',
            f'{kind}_tolerance',
            lambda f, value=value: np.where(np.arange(len(f)) == 3, value, f),
        )
column('feed: a tenth lower than executed', CAUGHT, 'blocks', 'feed', lambda f: 0.9 * f)
column('axis: not a unit vector', CAUGHT, 'blocks', 'axis', lambda o: 1.01 * o)
column('interpolation: 7', CAUGHT, 'blocks', 'interpolation', lambda k: k + 7)
column('duration: zero', CAUGHT, 'blocks', 'duration', lambda d: 0 * np.nan_to_num(d))
for kind in ('contour', 'orientation'):
    column(
        f'{kind} tolerance: a tenth of the planned one',
        CAUGHT,
        'blocks',
        f'{kind}_tolerance',
        lambda f: f / 10,
    )
    # Tolerances are given; what they are is printed.
    column(
        f'{kind} tolerance: ten times as large',
        ACCEPTED,
        'blocks',
        f'{kind}_tolerance',
        lambda f: f * 10,
    )
for k in range(1, 6):
    column(
        f'vertex {k}: moved by 0.1 mm',
        CAUGHT,
        'blocks',
        'tip',
        lambda p, k=k: p + 1e-4 * (np.arange(len(p)) == k)[:, None],
    )
    column(
        f'word {k}: C by a whole turn',
        CAUGHT,
        'blocks',
        'rotary',
        lambda r, k=k: r + 2 * np.pi * np.outer(np.arange(len(r)) == k, [0, 1]),
    )
    column(
        f'word {k}: the other branch',
        CAUGHT,
        'blocks',
        'rotary',
        lambda r, k=k: np.where((np.arange(len(r)) == k)[:, None], r * [-1, 1] + [0, np.pi], r),
    )
column(
    'rows: one stop more', CAUGHT, 'blocks', 'exact_stop', lambda e: e | (np.arange(len(e)) == 2)
)


def drop_row(k):
    def change(content):
        for key, values in content['blocks'].items():
            content['blocks'][key] = np.delete(values, k, axis=0)

    return change


for k in range(6):
    manipulation(f'rows: {k} is left out', CAUGHT, drop_row(k))

# ---------------------------------------------------------------------- what the summary says
for key, values in {
    'flank_height': (0, -1, None, 'high', float('nan')),
    'interpolation_period': (0, 2e-3, 0.5e-3, 1e9, None, '1'),
    'overrides': (
        'all',
        [],
        [[0, 1000, 1]],
        [[0, 0.5, 1]],
        [[0, -1, 1]],
        [[0, float('nan'), 1]],
        [[1, 1, 1]],
        [[0, 1, 1], [float('inf'), 1, 1]],
        [[0, 1, 1], [200, 0.5, 1]],
    ),
    'cycle_time': (0, 1e9, 'long'),
    'samples': (5, 'many'),
    'blocks': (1,),
    'path_length': (1.0,),
    'largest_use': ({'velocity': {'X': 0.01}}, {'jerk': {'X': 'all'}}),
    'machine': ('nowhere', '../../etc/passwd', 5, 'xyzbc', 'xyz'),
}.items():
    for value in values:
        manipulation(
            f'summary: {key} is {value}',
            CAUGHT,
            lambda content, key=key, value=value: content['summary'].update({key: value}),
        )
manipulation(
    'summary: an override of 150 %',
    ACCEPTED,
    lambda content: content['summary'].update(overrides=[[0, 1.5, 1.0]]),
)
manipulation(
    'summary: another name of the program',
    ACCEPTED,
    lambda content: content['summary'].update(program='other\x1b[31m.ngc'),
)

# ---------------------------------------------------------------------- types, shapes and columns
manipulation(
    'a jerk column times 100',
    CAUGHT,
    lambda content: content['setpoints'].update(jerk=100 * content['setpoints']['acceleration']),
)
for file, key in (
    ('setpoints', 'position'),
    ('setpoints', 's'),
    ('path', 'cell_left'),
    ('path', 'stop'),
    ('blocks', 'tip'),
    ('blocks', 'line'),
):
    manipulation(
        f'{file}: {key} is missing',
        CAUGHT,
        lambda content, file=file, key=key: content[file].pop(key),
    )
    for name, change in {
        'as text': lambda a: a.astype('U3'),
        'complex': lambda a: a + 1j,
        'one row less': lambda a: a[..., :-1, :] if a.ndim > 1 else a[:-1],
        'a number': lambda a: np.array(1.0),
    }.items():
        column(f'{file}: {key} {name}', CAUGHT, file, key, change)


def is_like_another(name):
    """Tell whether a change is one of many of its kind: of an axis, of a block, at a place."""
    alike = ('Y:', 'Z:', 'A:', 'vertex 2', 'vertex 4', 'word 2', 'word 4')
    return name.startswith(alike) or name.endswith(('20%', '80%'))


@pytest.mark.parametrize(
    'name',
    [pytest.param(n, marks=pytest.mark.thorough if is_like_another(n) else ()) for n in TABLE],
)
def test_manipulated_files(name, sound, tmp_path, capsys):
    caught, change = TABLE[name]
    content = copy.deepcopy(sound)
    change(content)
    code, text = check(write(tmp_path, content), capsys)
    assert (code != 0) is caught, text
    assert '\x1b' not in text


@pytest.mark.parametrize('name', few_of(18, [*list(TABLE)[::9], 'block: backwards']))
def test_chunks_of_any_length_give_the_same_proof(name, sound, tmp_path, monkeypatch):
    content, proofs = copy.deepcopy(sound), []
    TABLE[name][1](content)
    write(tmp_path, content)
    for rows in (1 << 30, 311, 97):
        monkeypatch.setattr(plan_files, 'CHUNK', rows)
        try:
            proofs.append(verify_plan(tmp_path, MACHINE).to_json())
        except InterpError as refusal:
            proofs.append(str(refusal))
    assert proofs[1] == proofs[0] == proofs[2]


def test_columns_of_any_form_are_read(sound, tmp_path):
    content = copy.deepcopy(sound)
    content['setpoints']['block'] = content['setpoints']['block'].astype('<i4')
    content['setpoints']['position'] = np.asfortranarray(content['setpoints']['position'])
    write(tmp_path / 'other', content)
    np.savez_compressed(tmp_path / 'other' / 'path.npz', **content['path'])
    proofs = [verify_plan(write(tmp_path / 'plan', sound), MACHINE)]
    assert verify_plan(tmp_path / 'other', MACHINE).to_json() == proofs[0].to_json()
    assert proofs[0].ok
    # What is written as the planner does stays in the file, however long; the rest is loaded.
    plain, other = (
        plan_files._stored(tmp_path / name / 'setpoints.npz') for name in ('plan', 'other')
    )
    assert plain.keys() == sound['setpoints'].keys() == other.keys() | {'block', 'position'}
    assert len(other) == len(plain) - 2


def test_the_sound_plan_is_proven_and_says_what_is_given(sound, tmp_path, capsys):
    code, text = check(write(tmp_path, sound), capsys)
    assert code == 0 and text.endswith('\nproven\n')
    for words in (
        '6 blocks of five_axes.ngc, from blocks.npz (sha256 ',
        'xyzac, from the bundled',
        '0.02 mm contour',
        '30 mm, from summary.json',
    ):
        assert words in text
    assert 'not checked    segments.npz' not in text
    (tmp_path / 'segments.npz').write_bytes(b'nothing')
    assert 'not checked    segments.npz' in check(tmp_path, capsys)[1]
    # The hash is that of the program: another tolerance is another program.
    found = re.search(r'blocks\.npz \(sha256 (\w+)\)', text)[1]
    other = copy.deepcopy(sound)
    other['blocks']['contour_tolerance'] *= 2
    assert found not in check(write(tmp_path / 'other', other), capsys)[1]


@pytest.mark.parametrize('factor', [2.0, 0.9])
def test_a_machine_file_with_other_limits_is_named(factor, sound, tmp_path, capsys):
    machine = yaml.safe_load((machines_directory() / 'xyzac.yaml').read_text())
    for limits in machine['limits'].values():
        for key in limits:
            if not key.startswith('travel'):
                limits[key] *= factor
    file = tmp_path / 'relaxed.yaml'
    file.write_text(yaml.safe_dump(machine))
    code, text = check(write(tmp_path / 'plan', sound), capsys, '--machine', str(file))
    named = 'relaxed.yaml, which is not bundled and differs from the bundled xyzac'
    assert code == 1 and named in text and ('jerk of X' in text) is (factor < 1.0)
    plan_of(FIVE_AXES, tmp_path / 'plan', Machine.load(file))
    code, text = check(tmp_path / 'plan', capsys)
    assert code == 0 and named in text
    assert text.endswith(f'proven for the machine file {file}, which is not bundled\n')


# ---------------------------------------------------------------------- order of the strokes
#: Programs of strokes along one axis, and motions: positions that are visited, and the row each
#: stroke claims to execute. In mm or deg.
ORDERS = {
    (10, 0, 10, 0): {
        (10, 0, 10, 0): ACCEPTED,
        (10, 0): CAUGHT,
        (10, 0, 10, 0, 10, 0): CAUGHT,
        (10, 5, 10, 0, 10, 0): CAUGHT,
        (10, 0, 10, 0.5, 10, 0): CAUGHT,
        (10, 0, 5, 0): CAUGHT,
        (5, 0, 10, 0): CAUGHT,
    },
    (-2, 0, -4, 0): {
        (-2, 0, -4, 0): ACCEPTED,
        (-4, 0): CAUGHT,
        (-2, 0, -2, 0, -4, 0): CAUGHT,
        (-4, 0, -2, 0): CAUGHT,
        (-2, -4, 0): CAUGHT,
        (-2, -1, -4, 0): CAUGHT,
        (-2, 0, -4, -2, -4, 0): CAUGHT,
    },
    (2, 4, 6): {
        (2, 4, 6): ACCEPTED,
        (6,): ACCEPTED,  # one stroke passes all three
        (2, 0, 6): CAUGHT,
        (4, 2, 6): CAUGHT,
        (6, 4, 6): CAUGHT,
    },
}


def strokes(axis, program, visits, labels):
    """Files of a motion from rest to rest along X, along Z, or about C under a vertical tool."""
    j = MACHINE.axis_names.index(axis)
    unit = MM if j < 3 else DEG
    velocity = FEED if j < 3 else MACHINE.max_velocity[j]
    parts, rows, here = [], [], 0.0
    for target, label in zip(visits, labels, strict=True):
        part = stroke((target - here) * unit, velocity, *MACHINE.limits.by_order[1:, j])
        parts.append(part + np.array([[here * unit], [0], [0]]))
        rows.append(np.full(part.shape[1], label))
        here = target
    motion = np.zeros((3, sum(map(len, rows)), 5))
    motion[:, :, j] = np.concatenate(parts, axis=1)
    if j >= 3:  # the tip rests
        motion[0, :, :3] = turned_tip(motion[0, :, 3], motion[0, :, 4])
        for k in (1, 2):
            motion[k, :, :3] = np.gradient(motion[k - 1, :, :3], PERIOD, axis=0)
    points = np.array([0, *program]) * unit
    tip = np.zeros((len(points), 3))
    if j < 3:
        tip[:, j] = points
    content = files(MACHINE, motion, np.concatenate(rows), tip, FEED)
    if j >= 3:
        content['blocks']['rotary'] = np.column_stack([0 * points, points])
        content['blocks']['feed'][:] = 1.0
    return content


def label_sets(program, visits):
    """Rows that the strokes may claim: in order as far as they go, first, last, and spread."""
    count, last = len(visits), len(program)
    k = np.arange(count)
    return {
        tuple(row)
        for row in (
            np.minimum(k + 1, last),
            np.maximum(last - count + 1 + k, 1),
            np.round(np.linspace(1, last, count)).astype(int),
        )
    }


STROKES = [
    (program, visits, labels, caught)
    for program, motions in ORDERS.items()
    for visits, caught in motions.items()
    for labels in sorted(label_sets(program, visits))
]


@pytest.mark.parametrize(('axis', 'motion'), few_of(15, 'XZC', STROKES), ids=str)
def test_strokes_in_order(axis, motion, tmp_path, capsys):
    program, visits, labels, caught = motion
    code, text = check(write(tmp_path, strokes(axis, program, visits, labels)), capsys)
    if caught:
        assert code == 1 and 'out of order' in text, text
    elif len(labels) == len(program):
        assert code == 0, text


@pytest.mark.thorough
@pytest.mark.parametrize('axis', ['Z', 'C'])
@pytest.mark.parametrize('rows', [2, 53])
def test_strokes_in_chunks(axis, rows, tmp_path, monkeypatch):
    program, visits = (-2, 0, -4, 0), (-2, 0, -4, -2, -4, 0)
    for k, labels in enumerate(((1, 2, 3, 4), (1, 2, 3, 3, 3, 4), (1, 1, 2, 3, 3, 4))):
        motion = visits[: len(labels)] if k else program
        folder, proofs = write(tmp_path / str(k), strokes(axis, program, motion, labels)), []
        for length in (1 << 30, rows):
            monkeypatch.setattr(plan_files, 'CHUNK', length)
            proofs.append(verify_plan(folder, MACHINE).to_json())
        assert proofs[0] == proofs[1] and proofs[0]['ok'] is (k == 0)


@pytest.mark.parametrize('axis', ['X', 'C'])
def test_a_wrong_row_number_is_named(axis, tmp_path, capsys):
    program = (10, 0, 10, 0, 10, 0)
    for labels in ((1, 2, 4, 4, 5, 6), (1, 1, 3, 4, 5, 6), (1, 4, 4, 4, 5, 6)):
        content = strokes(axis, program, program, labels)
        code, text = check(write(tmp_path, content), capsys)
        assert code == 1 and 'wrong row number' in text, text


def test_a_wrong_row_number_does_not_lend_its_feed(tmp_path, capsys):
    content = strokes('X', (30, 60), (30, 60), (1, 2))
    content['blocks']['feed'][:] = [FEED, FEED, FEED / 2]
    content['setpoints']['block'][:] = 1
    text = check(write(tmp_path, content), capsys)[1]
    assert 'tip feed' in text and 'limit 1500 mm/min' in text
