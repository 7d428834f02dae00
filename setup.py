"""Package cnc_interp, for pip and for colcon alike."""

import re
import subprocess
from pathlib import Path
from typing import Any

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

NAME = 'cnc_interp'
ROOT = Path(__file__).parent
VERSION = re.findall(r"__version__ = '(.*)'", (ROOT / NAME / '__init__.py').read_text())[0]
NODES = ('lookahead', 'feedrate', 'machine', 'program', 'markers', 'joy_jog', 'batch')


def shared_files() -> list[tuple[str, list[str]]]:
    """List what ROS looks up under ``share``: index marker, package.xml, launch and config."""
    share = Path('share') / NAME
    found = [
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (str(share), ['package.xml']),
    ]
    for top in ('launch', 'config', 'examples'):
        folders = [Path(top), *sorted(p for p in Path(top).rglob('*') if p.is_dir())]
        for folder in folders:
            files = sorted(str(p) for p in folder.glob('*') if p.is_file() and p.suffix != '.pyc')
            if files:
                found.append((str(share / folder), files))
    return found


def note_commit(folder: Path) -> None:
    """Write the commit that is built beside the package; what a source package brings stays."""
    git = ['git', 'describe', '--always', '--dirty=+', '--exclude=*']
    if (ROOT / '.git').exists():
        found = subprocess.run(git, cwd=ROOT, capture_output=True, text=True).stdout
        (folder / NAME / 'commit.txt').write_text(found)


class BuildPy(build_py):  # type: ignore[misc]
    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            note_commit(Path(self.build_lib))


class Sdist(sdist):  # type: ignore[misc]
    def make_release_tree(self, base_dir: str, files: Any) -> None:
        super().make_release_tree(base_dir, files)
        note_commit(Path(base_dir))


setup(
    name=NAME,
    version=VERSION,
    cmdclass={'build_py': BuildPy, 'sdist': Sdist},
    description='Real-time 5-axis CNC interpolator whose every emitted setpoint is proven.',
    author='cnc_interp maintainers',
    license='Apache-2.0',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={
        NAME: ['py.typed', 'commit.txt'],
        **{f'{NAME}.{room}': ['*.css', '*.js'] for room in ('page', 'report', 'batch')},
        f'{NAME}.cam': ['*.html', '*.js'],
        f'{NAME}.problems': ['*.csv'],
        f'{NAME}.processes': ['*.xml'],
    },
    data_files=shared_files(),
    python_requires='>=3.11,<3.14',
    # Without ROS: plan, check, report, convert, cam. ROS 2 itself comes with its own installation.
    install_requires=[
        'PyYAML>=6,<7',
        'argparse-manpage>=4.6,<5',
        'lark-parser>=0.12,<1',
        'matplotlib>=3.5,<4',
        'numba>=0.68,<1',
        'numpy>=1.26,<2.3',
        'plotly>=5,<8',
        'ruckig>=0.9,<1',
        'scipy>=1.11,<2',
        'shtab>=1.7,<2',
        'toppra>=0.6,<0.7',
    ],
    # LGPL-2.1 with an exception (OpenCASCADE); its bindings are Apache-2.0.
    extras_require={
        'ros': ['apsw>=3.40,<4', 'mcap>=1.1,<2', 'rosbags>=0.11,<0.12'],
        'page': ['nicegui>=3,<4'],
        'batch': [
            'dask>=2024,<2027',
            'distributed>=2024,<2027',
            'bokeh>=3.1,<4',
        ],
        'step': ['cadquery-ocp-novtk>=8.0,<9'],
        'tiles': ['zarr>=3.1,<4'],
    },
    zip_safe=False,
    entry_points={
        'console_scripts': [
            'cnc-interp = cnc_interp.__main__:main',
            *(f'{node}_node = cnc_interp.__main__:run_node' for node in NODES),
        ]
    },
)
