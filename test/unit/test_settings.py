"""Settings: command line, parameters, goals, bags and the page are made of one declaration."""

import re
import subprocess
import sys
from argparse import ArgumentParser
from dataclasses import fields, replace
from pathlib import Path

import pytest
import yaml
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import G1Block
from diagnostic_msgs.msg import KeyValue

from cnc_interp.commands.cli import main, parser
from cnc_interp.core import DEG, SettingsError, StreamError
from cnc_interp.nodes import parameters
from cnc_interp.settings.command_line import add_settings, command_words, settings_from
from cnc_interp.settings.option_kinds import Stage, choices, shortest
from cnc_interp.settings.options import (
    Settings,
    filled_in,
    offered,
    settings_filled_in,
    texts_of,
    with_texts,
)
from cnc_interp.wire.message_checks import check_block
from cnc_interp.wire.run_messages import (
    goal_of,
    loaded_program,
    pairs_of,
    settings_of_block,
    settings_of_goal,
)

#: Adds a choice to the declarations before anything else is imported, then looks for it.
ONE_MORE = """
from dataclasses import dataclass
from pathlib import Path

import cnc_interp.settings.options as place
from cnc_interp.settings.option_kinds import LENGTH, Stage, number

@dataclass(frozen=True)
class Settings(place.Settings):
    peck_depth: float = number(
        0.002, LENGTH, (0.001, 0.005), Stage.SMOOTHING, 'depth that a test adds'
    )

place.Settings = Settings

from cnc_interp.commands.cli import main, parser
from cnc_interp.nodes import parameters
from cnc_interp.settings.command_line import command_words, settings_from
from cnc_interp.settings.options import filled_in, offered, settings_filled_in, values_of
from cnc_interp.wire.run_messages import (
    goal_of, loaded_program, pairs_of, settings_from as settings_told, settings_of_goal
)

words = ['plan', 'x', '--out', 'y', '--peck-depth', '3']
told = settings_from(parser().parse_args(words))
assert told.peck_depth == 0.003 and command_words(told) == ['--peck-depth=3']
assert 'depth that a test adds (2 mm)' in ' '.join(
    parser()._subparsers._group_actions[0].choices['plan'].format_help().split()
)
for node in ('program_node', 'lookahead_node'):
    (declared,) = [p for p in parameters.NODES[node] if p.name == 'peck_depth']
    assert (declared.default, declared.low, declared.high) == (0.002, 0.001, 0.005)
    assert 'depth that a test adds [m]' in parameters.descriptor_of(declared).description.lower()
assert settings_of_goal(goal_of(Path('x'), told), Settings()) == told
assert settings_told(loaded_program('p', 'x', '', told).settings, Settings()) == told
assert values_of(told)['peck_depth'] == 0.003
(field,) = [choice for choice in offered() if choice.name == 'peck_depth']
assert field.unit.name == 'mm' and filled_in(told)['peck_depth'] == '3'
assert settings_filled_in(Settings(), filled_in(Settings()) | {'peck_depth': '3'}) == told
"""

ROOT = Path(__file__).parents[2]
#: No choice has its default here; the numbers need all their digits.
OTHERS = Settings(
    contour_tolerance=1.0e-5 / 3.0,
    orientation_tolerance=7.0e-5 / 3.0,
    flank_height=0.1 / 3.0,
    force_tolerances=True,
    feedrate=0.05 / 3.0,
    setup=Path('job.yaml').resolve(),
    interpolation='axes',
    rotary_sense='shortest',
    dialect='fanuc',
    arc_centres='reversed',
    units='inch',
    numbers='increments',
    skip_blocks=True,
    most_jumps=77,
    corner_ratio=5.0 / 3.0,
    corner='paper',
    parametrization='linear',
    top='tolerance',
    septic=True,
    compress=False,
    longest_block=0.01 / 3.0,
    corner_angle=50.0 * DEG,
    tolerance_share=2.0 / 3.0,
    interpolation_period=0.002,
    compensation='identified.yaml',
    learnt=Path('learnt.npz').resolve(),
    tool_error=1.0e-4 / 3.0,
    scene=Path('scene.yaml').resolve(),
    collision='warn',
    from_line=12,
    line_pass=3,
    retract=0.1 / 3.0,
    plunge_feed=0.01 / 3.0,
    spin='auto',
)


def on_command_line(words):
    taker = ArgumentParser()
    add_settings(taker)
    return settings_from(taker.parse_args(words))


def test_the_example_leaves_no_choice_at_its_default():
    default = Settings()
    names = [field.name for field in fields(Settings)]
    assert not [name for name in names if getattr(OTHERS, name) == getattr(default, name)]


@pytest.mark.parametrize('settings', [Settings(), OTHERS, replace(OTHERS, corner_ratio=None)])
def test_the_command_line_gives_the_settings_that_made_its_words(settings):
    found = on_command_line(command_words(settings))
    for choice in choices(Settings):
        value, wanted = getattr(found, choice.name), getattr(settings, choice.name)
        close = choice.kind is float and wanted is not None
        assert value == (pytest.approx(wanted, rel=1e-15) if close else wanted)
    assert not command_words(Settings())


@pytest.mark.parametrize('settings', [Settings(), OTHERS, replace(OTHERS, corner_ratio=None)])
def test_texts_and_parameters_keep_every_bit(settings):
    start = OTHERS if settings == Settings() else Settings()
    assert with_texts(start, texts_of(settings).items()) == settings
    plain = {c.name: c.plain(getattr(settings, c.name)) for c in choices(settings)}
    assert parameters.settings_of(plain) == settings


def test_plan_launch_and_goal_have_the_same_defaults():
    """corner_angle was 0.610865 in `plan` and 0.6109 under `ros2 launch`."""
    planned = settings_from(parser().parse_args(['plan', 'x', '--out', 'y']))
    sections = yaml.safe_load((ROOT / 'config' / 'nodes.yaml').read_text())
    launched = Settings()
    for node, declared in parameters.NODES.items():
        values = {p.name: p.default for p in declared}
        for place in (f'/**/{node}', '/**'):
            values |= sections.get(place, {}).get('ros__parameters', {})
        known = {c.name: c for c in choices(Settings) if c.name in values}
        of_node = {name: choice.from_plain(values[name]) for name, choice in known.items()}
        assert replace(launched, **of_node) == launched, node
    assert planned == launched == settings_of_goal(RunProgram.Goal(), Settings())


def test_nodes_declare_every_choice_where_it_is_used():
    for stage, nodes in {
        Stage.READING: ['program_node'],
        Stage.SMOOTHING: ['program_node', 'lookahead_node'],
        Stage.MOTION: ['program_node', 'feedrate_node', 'machine_node'],
        Stage.PLANNING: ['program_node', 'feedrate_node'],
        Stage.APPROACH: ['program_node', 'feedrate_node'],
    }.items():
        for node in nodes:
            declared = {p.name: p for p in parameters.NODES[node]}
            for choice in choices(Settings, stage):
                descriptor = parameters.descriptor_of(declared[choice.name])
                assert choice.sentence[1:] in descriptor.description
                assert bool(descriptor.floating_point_range) == (choice.kind is float)


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('contour_tolerance', 0.0),
        ('contour_tolerance', float('nan')),
        ('feedrate', -1.0),
        ('corner_ratio', 1.1),
        ('corner_angle', 3.2),
        ('tolerance_share', 1.01),
        ('longest_block', '5'),
        ('compress', 1),
        ('top', 'upper'),
        ('setup', 'job.yaml'),
        ('most_jumps', 0.5),
        ('interpolation_period', True),
    ],
)
def test_impossible_values_are_refused_by_name(name, value):
    with pytest.raises(SettingsError, match=name) as caught:
        Settings(**{name: value})
    assert caught.value.name == name


def test_wrong_words_are_refused_in_units_of_the_shop(capsys):
    for words, said in (
        (['--ratio', '5'], 'argument --ratio: 5 is not between 1.2 and 4'),
        (['--ratio', 'round'], "argument --ratio: 'round' is not a number or 'auto'"),
        (
            ['--corner-angle', '200'],
            '--corner-angle: 200 deg is not between 0.01 and 180 deg',
        ),
        (['--contour-tolerance', '0'], '0 mm is not between'),
        (['--top', 'upper'], 'invalid choice'),
    ):
        with pytest.raises(SystemExit):
            on_command_line(words)
        assert said in capsys.readouterr().err


def test_a_goal_carries_all_choices_and_its_fields_still_count():
    asked = replace(OTHERS, spin='fixed')  # the nodes have no other
    assert settings_of_goal(goal_of(Path('p'), asked), replace(Settings(), **MOTION)) == asked
    goal = RunProgram.Goal(contour_tolerance=1e-4, interpolation='vector', feedrate=0.1)
    found = settings_of_goal(goal, Settings(corner_ratio=2.0))
    wanted = {'contour_tolerance': 1e-4, 'interpolation': 'vector', 'feedrate': 0.1}
    assert found == Settings(corner_ratio=2.0, **wanted)
    goal.settings = goal_of(
        Path('p'), Settings(feedrate=0.2, compress=False), ['feedrate', 'compress']
    ).settings
    assert settings_of_goal(goal, Settings()) == Settings(
        **wanted | {'feedrate': 0.2}, compress=False
    )


OF_NODES = Stage.MOTION, Stage.PLANNING, Stage.APPROACH
MOTION = {c.name: getattr(OTHERS, c.name) for c in choices(Settings, *OF_NODES)}


@pytest.mark.parametrize(
    ('key', 'value', 'said'),
    [
        ('corner_radius', '1', 'corner_radius: this choice is unknown; known: contour_tolerance,'),
        ('corner_ratio', 'wide', "corner_ratio: 'wide' is not a number or 'auto'"),
        ('corner_ratio', '5.0', 'corner_ratio: 5 is not between 1.2 and 4'),
        ('compress', 'yes', "compress: 'yes' is unknown; choose true or false"),
        ('top', 'upper', "top: 'upper' is unknown; choose in_step or tolerance"),
        ('contour_tolerance', 'nan mm', 'contour_tolerance: nan mm is not between'),
        ('contour_tolerance', '0.02', "contour_tolerance: '0.02' has no unit; write 0.02 mm or"),
        ('contour_tolerance', '0.02 m', 'contour_tolerance: 20 mm is not between'),
        ('contour_tolerance', '0.02 inch', "contour_tolerance: '0.02 inch' is not a number in mm"),
        ('contour_tolerance', '', "contour_tolerance: '' is not a number"),
        (
            'interpolation_period',
            '2 ms',
            'interpolation_period: the nodes were started',
        ),
        ('spin', 'auto', 'spin: the nodes have only fixed; use `plan`'),
        ('law', 'vpop', 'law: this choice is unknown; known: contour_tolerance,'),
    ],
)
def test_a_goal_with_a_wrong_choice_is_refused_by_name(key, value, said):
    with pytest.raises(SettingsError) as caught:
        settings_of_goal(RunProgram.Goal(settings=[KeyValue(key=key, value=value)]), Settings())
    assert str(caught.value).startswith(said)


def test_run_does_not_offer_what_only_plan_can_do(capsys):
    with pytest.raises(SystemExit, match='2'):
        main(['run', 'part.ngc', '--spin', 'auto'])
    assert 'unknown option --spin' in capsys.readouterr().err


def test_a_choice_that_is_given_twice_is_refused():
    twice = [KeyValue(key='septic', value=value) for value in ('true', 'false')]
    with pytest.raises(SettingsError, match='septic: this choice is given twice'):
        settings_of_goal(RunProgram.Goal(settings=twice), Settings())


def test_block_0_carries_the_settings_of_the_run_and_leaves_others_to_the_look_ahead():
    own = Settings(corner_ratio=3.0, compress=False)
    block = G1Block(
        axis=[0.0, 0.0, 1.0],
        contour_tolerance=1e-5,
        orientation_tolerance=1e-5,
        flank_height=OTHERS.flank_height,
    )
    assert settings_of_block(block, own) == replace(own, flank_height=OTHERS.flank_height)
    block.settings = pairs_of(OTHERS)
    check_block(block)
    assert settings_of_block(block, own) == OTHERS
    block.settings = [pair for pair in block.settings if pair.key == 'corner_ratio']
    assert settings_of_block(block, own).corner_ratio == OTHERS.corner_ratio
    assert not settings_of_block(block, own).compress
    block.settings = [KeyValue(key='corner_radius', value='1')]
    with pytest.raises(StreamError, match=r'block 0 .*corner_radius: this choice is unknown'):
        check_block(block)
    block.sequence, block.feedrate = 1, 0.1
    with pytest.raises(StreamError, match='settings belong to block 0'):
        check_block(block)


def test_the_loaded_program_tells_the_settings_and_its_old_fields():
    told = loaded_program('p', 'part.ngc', 'G0', OTHERS)
    assert {pair.key: pair.value for pair in told.settings} == texts_of(OTHERS)
    assert told.feedrate == OTHERS.feedrate and told.interpolation == 'axes'
    assert loaded_program('p', 'part.ngc', 'G0', Settings()).feedrate == 0.0


def test_a_choice_added_in_one_place_is_found_in_all_five():
    """On the command line, as parameter, in a goal, in bag and summary, and in the dialog."""
    done = subprocess.run([sys.executable, '-c', ONE_MORE], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()


def test_the_form_gives_the_settings_that_filled_it_in():
    form = filled_in(OTHERS)
    assert form['feedrate'] == '1000' and form['force_tolerances'] == 'true'
    assert shortest(0.1 + 0.2, 1.0) == '0.30000000000000004'
    found = settings_filled_in(OTHERS, form)
    for choice in offered():
        value, wanted = getattr(found, choice.name), getattr(OTHERS, choice.name)
        assert value == (pytest.approx(wanted, rel=1e-15) if choice.kind is float else wanted)
    empty = settings_filled_in(
        OTHERS, form | {'feedrate': '', 'setup': '', 'corner_ratio': 'auto'}
    )
    assert empty.feedrate is empty.setup is empty.corner_ratio is None
    with pytest.raises(SettingsError, match='flank_height'):
        settings_filled_in(OTHERS, form | {'flank_height': 'high'})
    hidden = {c.name for c in choices(Settings)} - {c.name for c in offered()}
    compared = {'corner', 'parametrization', 'top', 'septic'}
    of_nodes = {'interpolation_period', 'compensation', 'learnt', 'tool_error', 'spin'}
    of_nodes |= {'scene', 'collision'}
    assert hidden == compared | of_nodes | {'retract', 'plunge_feed', 'from_line', 'line_pass'}


def test_the_documentation_tells_each_choice_that_has_another_name_than_its_option():
    page = (ROOT / 'docs' / 'operate' / 'operation.md').read_text(encoding='utf-8')
    unlike = {c.name: c.option for c in choices(Settings) if c.name != c.option.replace('-', '_')}
    told = dict(re.findall(r'`(\w+)` is `--([\w-]+)`', ' '.join(page.split())))
    assert told == unlike
