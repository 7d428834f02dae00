"""Imports run the way the data flows and are declared; what sources may say."""

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / 'cnc_interp'

# Upstream first: a room imports only itself and rooms above it.
FLOW = (
    'kernel_cache',
    'core',
    'processes',
    'settings',
    'machine_model',
    'program',
    'smoothing',
    'kinematics',
    'collision',
    'drives',
    'feedrate',
    'run',
    'machine',
    'wire',
    'proof',
    'convert',
    'report',
    'description',
    'cam',
    'library',
    'problems',
    'batch',
    'nodes',
    'client',
    'page',
    'mtconnect',
    'commands',
    '__main__',
)

#: The folders of the largest room in their order, with its own modules before and after them.
PROGRAM = (
    ('job', 'notices'),
    ('text',),
    ('geometry',),
    ('blocks',),
    ('modal',),
    ('motion',),
    ('execution',),
    ('readers',),
    ('reading', 'setup_table', 'tool_files', 'writer'),
)

# The proof shares no code with the planner: what it may import, all of it.
PROOF_ROOM = 'proof'
PROOF_MAY_IMPORT = (
    'cnc_interp.collision.scene',
    'cnc_interp.collision.scene_file',
    'cnc_interp.core.tables',
    'cnc_interp.core.kernels',
    'cnc_interp.core.small_files',
    'cnc_interp.program.blocks',
    'cnc_interp.drives.compensation',
    'cnc_interp.drives.tool_error',
    'cnc_interp.machine_model.five_axis',
    'cnc_interp.machine_model.joint',
    'cnc_interp.machine_model.links',
    'cnc_interp.machine_model.machine',
    'cnc_interp.machine_model.signals',
    'cnc_interp.machine_model.transform_port',
    'cnc_interp.proof',
)

#: Of the names in ``core`` itself the proof uses types, units and errors, none that computes.
VECTORS = {'dot', 'cross', 'norm', 'unit', 'scaled'}

#: ROS is spoken here; messages, which are plain data, in ``wire`` too.
ROS_ROOMS, MESSAGE_ROOM = ('nodes', 'client', 'page', 'mtconnect'), 'wire'
# ament_index_python only finds installed files: any room may ask it.
ROS_MODULES = ('rclpy', 'rosbags', 'rcl_interfaces', 'std_srvs')

# Imported, but without a rosdep key: the README names them for a full ROS 2.
WITHOUT_KEY = {
    'OCP',
    'apsw',
    'argparse_manpage',
    'contourpy',
    'dask',
    'distributed',
    'fastapi',
    'lxml',
    'mcap',
    'nicegui',
    'plotly',
    'rosbags',
    'ruckig',
    'shtab',
    'starlette',
    'zarr',
}
RENAMED = {
    'toppra': 'python3-toppra-pip',
    'yaml': 'python3-yaml',
    'lark': 'python3-lark-parser',
    'ament_index_python': 'rclpy',
    'llvmlite': 'python3-numba',  # its own dependency
}

#: A possessive quantifier or an atomic group. Debian 12's Python 3.11.2 matches them wrongly.
POSSESSIVE = re.compile(r'(?<!\\)[*+?}]\+|\(\?>')


def modules():
    return sorted(PACKAGE.rglob('*.py'))


def dotted_name(path):
    parts = ('cnc_interp', *path.relative_to(PACKAGE).with_suffix('').parts)
    return '.'.join(parts[:-1] if parts[-1] == '__init__' else parts)


@cache
def is_module(name):
    place = PACKAGE.parent.joinpath(*name.split('.'))
    return place.is_dir() or place.with_suffix('.py').is_file()


@cache
def nodes_of(source):
    """Imports and texts of a source: it is parsed and walked once for all tests."""
    kinds = ast.Import, ast.ImportFrom, ast.Constant
    return [node for node in ast.walk(ast.parse(source)) if isinstance(node, kinds)]


def imported_names(source, module, is_package=False):
    """Every module a source imports, wherever in it the statement stands."""
    for node in nodes_of(source):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ''
            if node.level:
                here = module.split('.')
                keep = len(here) - node.level + (1 if is_package else 0)
                base = '.'.join([*here[:keep], *([node.module] if node.module else [])])
            inside = [f'{base}.{alias.name}' for alias in node.names]
            modules_inside = [name for name in inside if base == 'cnc_interp' or is_module(name)]
            yield from modules_inside or [base]


def program_place(module):
    folder = module.split('.')[2:3]
    return next((at for at, names in enumerate(PROGRAM) if folder and folder[0] in names), None)


def core_names(source):
    """The names that a source takes from the package ``core`` itself."""
    return {
        alias.name
        for node in nodes_of(source)
        if isinstance(node, ast.ImportFrom) and node.module == 'cnc_interp.core'
        for alias in node.names
    }


def room_of(module):
    parts = module.split('.')
    return parts[1] if len(parts) > 1 else ''


def faults(module, source, is_package=False):
    """Say what is wrong with the imports of one module, one line each."""
    room = room_of(module)
    for name in imported_names(source, module, is_package):
        top = name.split('.')[0]
        if top in ROS_MODULES or top.endswith('_msgs'):
            message = top.endswith('_msgs') and room == MESSAGE_ROOM
            if room not in ROS_ROOMS and not message:
                yield f'{module} imports {name}: only {" and ".join(ROS_ROOMS)} speak ROS'
        elif top == 'cnc_interp' and room_of(name):
            other = room_of(name)
            if other not in FLOW:
                # A value of the package itself, such as __version__, is no room.
                if is_module(name):
                    yield f'{module} imports {name}, a room that FLOW does not know: add it'
            elif FLOW.index(other) > FLOW.index(room):
                yield f'{module} imports {name}, which lies downstream of it'
            elif room == room_of(name) == 'program':
                here, there = program_place(module), program_place(name)
                if here is not None and (there is None or there > here):
                    yield f'{module} imports {name}, which lies downstream of it in the room'
            words = name == 'cnc_interp.core' and not core_names(source) & VECTORS
            allowed = name in PROOF_MAY_IMPORT or name.startswith(f'cnc_interp.{PROOF_ROOM}.')
            if room == PROOF_ROOM and not (words or allowed):
                yield f'{module} imports {name}: the proof shares no code with the planner'


def test_every_room_is_listed():
    rooms = {room_of(dotted_name(path)) for path in modules()} - {''}
    unknown = sorted(rooms - set(FLOW))
    assert not unknown, f'add {unknown} to FLOW of this test, where the data passes it'


def test_every_folder_of_the_reader_is_listed():
    places = PACKAGE / 'program'
    there = {p.parent.name for p in places.glob('*/__init__.py')}
    there |= {p.stem for p in places.glob('*.py')} - {'__init__'}
    assert there == {name for names in PROGRAM for name in names}


def test_imports_follow_the_flow():
    found = [
        fault
        for path in modules()
        if room_of(dotted_name(path)) in FLOW
        for fault in faults(dotted_name(path), path.read_text(), path.name == '__init__.py')
    ]
    assert not found, found


def circles(imports):
    """Return the modules that import themselves through others."""
    reached = {name: set(others) for name, others in imports.items()}
    for name in reached:
        for others in reached.values():
            if name in others:
                others |= reached[name]
    return sorted(name for name, others in reached.items() if name in others)


def test_no_modules_import_each_other():
    found = {}
    for path in modules():
        name, is_package = dotted_name(path), path.name == '__init__.py'
        found[name] = {*imported_names(path.read_text(), name, is_package)} - {name}
    assert circles(found) == []


def test_circles_are_seen():
    assert circles({'a': {'b'}, 'b': {'c'}, 'c': {'d'}, 'd': {'b'}, 'e': {'a'}}) == ['b', 'c', 'd']


def test_no_start_waits_for_splines_and_optimisers_of_scipy_or_for_methods_to_compare():
    """A merged file brought scipy.interpolate into every plan and node: a quarter of a second."""
    script = (
        'import sys, cnc_interp.run.planning_chain, cnc_interp.run.run_planner\n'
        'import cnc_interp.commands.cli\n'
        "heavy = ('interpolate', 'optimize', 'ndimage', 'signal', 'spatial', 'sparse')\n"
        "print([name for name in heavy if f'scipy.{name}' in sys.modules])\n"
        'import cnc_interp.nodes.feedrate_node, cnc_interp.nodes.lookahead_node\n'
        "print([name for name in sys.modules if name.endswith('.paper_parametrization')])"
    )
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True)
    assert done.stdout == '[]\n[]\n', done.stderr


@pytest.mark.parametrize(
    ('module', 'source'),
    [
        (
            'cnc_interp.program.readers.gcode',
            'from cnc_interp.kinematics.axis_path import AxisPath',
        ),
        ('cnc_interp.program.readers.gcode', 'import cnc_interp.commands.cli'),
        ('cnc_interp.program.readers.gcode', 'from cnc_interp import nodes'),
        ('cnc_interp.program.readers.gcode', 'from ...kinematics import axis_path'),
        ('cnc_interp.program.readers.gcode', 'def read():\n    import rclpy.node'),
        ('cnc_interp.report.html', 'from cnc_interp_msgs.msg import G1Block'),
        ('cnc_interp.commands.cli', 'from rosbags.rosbag2 import Reader'),
        ('cnc_interp.wire.path_messages', 'from rclpy.serialization import serialize_message'),
        ('cnc_interp.run.planning_chain', 'import rclpy'),
        ('cnc_interp.proof.verify', 'from cnc_interp.smoothing import corner'),
        ('cnc_interp.proof.verify', 'from cnc_interp.program.blocks.moves import Moves'),
        ('cnc_interp.program.text.flow', 'from cnc_interp.program.modal.state import ModalState'),
        ('cnc_interp.program.modal.state', 'from cnc_interp.program.readers import gcode'),
        ('cnc_interp.proof.verify', 'from cnc_interp.kinematics.path_builder import build'),
    ],
)
def test_wrong_imports_are_seen(module, source):
    assert list(faults(module, source))


@pytest.mark.parametrize(
    ('module', 'source'),
    [
        ('cnc_interp.kinematics.path_builder', 'from cnc_interp.program.blocks import Blocks'),
        ('cnc_interp.nodes.program_node', 'import rclpy\nfrom cnc_interp_msgs.msg import G1Block'),
        ('cnc_interp.wire.path_messages', 'from cnc_interp_msgs.msg import G1Block'),
        ('cnc_interp.client.session', 'import rclpy'),
        ('cnc_interp.commands.cli', 'from cnc_interp import __version__, verify'),
        ('cnc_interp.proof.verify', 'from cnc_interp.machine_model.machine import Machine'),
        ('cnc_interp.program.readers.gcode', 'from ..text.words import split_words'),
    ],
)
def test_right_imports_pass(module, source):
    assert not list(faults(module, source))


def test_package_xml_declares_what_is_imported():
    declared = {e.text for e in ElementTree.parse(ROOT / 'package.xml').iter('exec_depend')}
    sources = [*modules(), *(ROOT / 'launch').rglob('*.py')]
    imported = {
        name.partition('.')[0]
        for path in sources
        for name in imported_names(path.read_text(), 'cnc_interp.any.module')
    }
    missing = {
        name
        for name in imported - {'cnc_interp', *sys.stdlib_module_names, *WITHOUT_KEY}
        if not {name, f'python3-{name}', RENAMED.get(name)} & declared
    }
    assert not missing, f'add an exec_depend for {sorted(missing)} to package.xml'


def test_no_pattern_is_possessive():
    found = {
        (path.name, node.value)
        for path in modules()
        for node in nodes_of(path.read_text())
        if isinstance(node, ast.Constant) and isinstance(node.value, str | bytes)
        if POSSESSIVE.search(
            node.value if isinstance(node.value, str) else node.value.decode('latin-1')
        )
    }
    assert not found


@pytest.mark.parametrize('pattern', [r'\d++', r'(?:\s|a)*+', r'a?+', r'a{2}+', r'(?>a)'])
def test_possessive_patterns_are_seen(pattern):
    assert POSSESSIVE.search(pattern)
