"""Versions are pinned and agree, all files are installed; wheels are adapted without harm."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

import cnc_interp

ROOT = Path(__file__).parents[2]


def pins(name):
    lines = (ROOT / 'requirements' / f'{name}.txt').read_text().splitlines()
    return [line for line in lines if line and not line.startswith('#')]


@pytest.mark.parametrize(
    'name',
    [
        'ros-jazzy',
        'run',
        'build',
        'source',
        'test',
        'docs',
        'panel',
        'step',
        'batch',
        'tiles',
        'colcon',
    ],
)
def test_every_requirement_is_pinned(name):
    assert pins(name)
    assert all(
        re.fullmatch(r'[\w.-]+==[\w.]+(; python_version [<>=]+ "3\.\d+")?', line)
        for line in pins(name)
    )


def test_what_is_not_python_is_installed_too(tmp_path):
    command = [sys.executable, 'setup.py', '-q', 'build_py', '--build-lib', str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True)

    def others(root):
        found = (path.relative_to(root) for path in (root / 'cnc_interp').rglob('*.*'))
        kept = (path for path in found if '__pycache__' not in path.parts)
        return {path for path in kept if path.suffix != '.py'}

    commit = {Path('cnc_interp/commit.txt')}
    assert others(ROOT) == others(tmp_path) - commit != set()


def test_numpy_is_that_of_jazzy():
    assert 'numpy==1.26.4; python_version < "3.13"' in pins('run')


def test_versions_agree():
    told = subprocess.run(
        [sys.executable, 'setup.py', '--version'], cwd=ROOT, capture_output=True, text=True
    )
    version = told.stdout.split()[-1]
    assert version == cnc_interp.__version__
    assert yaml.safe_load((ROOT / 'CITATION.cff').read_text())['version'] == version
    for folder in ('.', 'msg_defs'):
        package = ElementTree.parse(ROOT / folder / 'package.xml').getroot()
        assert package.findtext('version') == version


def test_wheel_exports_are_relocated_once():
    spec = importlib.util.spec_from_file_location('ros_wheels', ROOT / 'tools' / 'ros_wheels.py')
    ros_wheels = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(ros_wheels)
    builder = '/opt/python/cp312-cp312'
    text = (
        f'"${{_IMPORT_PREFIX}}/include;{builder}/include/python3.12;'
        f'{builder}/lib/python3.12/site-packages/numpy/_core/include"'
    )
    once = ros_wheels.relocate(text, '/here/include', '/here/numpy/include')
    assert once == '"${_IMPORT_PREFIX}/include;/here/include;/here/numpy/include"'
    assert ros_wheels.relocate(once, '/elsewhere', '/elsewhere') == once
