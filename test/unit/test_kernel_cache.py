"""Compiled kernels never outlive a change of what they call or read, and outlive all others."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cnc_interp import kernel_cache

CONSTANT = 'VALUE = {value}\n'
INNER = (
    'from pack.core.kernels import njit\nfrom pack.limits import VALUE\n\n'
    '@njit(cache=True)\ndef inner():\n    return VALUE\n'
)
OUTER = (
    'from pack.core.kernels import njit\nfrom pack.inner import inner\n\n'
    '@njit(cache=True)\ndef outer():\n    return inner()\n'
)
ASK = 'from pack.outer import outer; print(outer(), sum(outer.stats.cache_hits.values()))'


@pytest.fixture
def package(tmp_path):
    """A package with our cache: one kernel calls another, which reads a constant."""
    folder = tmp_path / 'pack'
    (folder / 'core').mkdir(parents=True)
    for name in ('kernel_cache', 'core/kernels', 'core/compile_time'):
        text = (kernel_cache.PACKAGE / f'{name}.py').read_text()
        (folder / f'{name}.py').write_text(text.replace(kernel_cache.PACKAGE.name, 'pack'))
    for name, text in (
        ('__init__', ''),
        ('core/__init__', ''),
        ('limits', CONSTANT.format(value=1)),
        ('inner', INNER),
        ('outer', OUTER),
        ('plain', 'x = 1\n'),
    ):
        (folder / f'{name}.py').write_text(text)
    return folder


IMPORT = 'from pack.core.kernels import njit\n\n'
TWICE = IMPORT + '@njit(cache=True)\ndef twice(x):\n    return x + x\n'
#: Its code holds a function of numba's, which raises.
LARGEST = IMPORT + '@njit(cache=True)\ndef largest(x):\n    return x.max()\n'
#: Compiles one form of a kernel; between reading numba's index and writing it time passes.
SLOWLY = (
    'import time\nfrom numba.core.caching import IndexDataCacheFile as Files\n'
    'from pack.twice import twice\nread = Files._load_index\n'
    'def slow(self):\n    found = read(self)\n    time.sleep(1.0)\n    return found\n'
    'Files._load_index = slow\nprint(twice({value}))\n'
)


def environment(package):
    """Variables of a process that finds the package, and its kernels in the package's folder."""
    found = {
        **os.environ,
        'PYTHONPATH': str(package.parent),
        'PYTHONDONTWRITEBYTECODE': '1',  # Python itself misses a change within the same second
    }
    found.pop(kernel_cache.FOLDER, None)
    return found


def outer(package, first='', **variables):
    """What the outer kernel says in a fresh process, and whether its code was there."""
    done = subprocess.run(
        [sys.executable, '-c', first + ASK],
        env=environment(package) | variables,
        capture_output=True,
        text=True,
        check=True,
    )
    said, found = done.stdout.split()
    return int(said), found == '1'


@pytest.mark.thorough
def test_code_is_kept_until_something_changes_that_the_kernel_depends_on(package):
    assert outer(package) == (1, False)
    (package / 'plain.py').write_text('x = 2\n')
    assert outer(package) == (1, True)
    (package / 'limits.py').write_text(CONSTANT.format(value=2))  # has no kernel, is not imported
    assert outer(package) == (2, False)
    (package / 'inner.py').write_text(INNER.replace('return VALUE', 'return 10 * VALUE'))
    assert outer(package) == (20, False)
    assert outer(package) == (20, True)
    (package / 'outer.py').write_text(OUTER.replace('inner()\n', 'inner() + 1\n'))
    assert outer(package) == (21, False)  # compiled with the inner kernel's code from its file
    assert outer(package) == (21, True)
    later = OUTER.replace('inner()\n', 'inner() + 2\n')
    change = f'import pack.outer; open(pack.outer.__file__, "w").write({later!r}); '
    assert outer(package, change) == (21, True)  # its sources count as they were imported
    assert outer(package) == (22, False)


@pytest.mark.thorough
def test_kernels_that_a_wheel_brings_are_taken_while_they_are_current(package):
    made = {'NUMBA_CPU_NAME': kernel_cache.PROCESSOR, 'NUMBA_CPU_FEATURES': ''}
    into = {kernel_cache.FOLDER: str(package / kernel_cache.BROUGHT.name)}
    assert outer(package, **made, **into) == (1, False)
    assert outer(package) == (1, True)  # by the host's own name of its processor
    assert outer(package, NUMBA_CPU_FEATURES='+sse2') == (1, False)  # an older processor
    (package / 'limits.py').write_text(CONSTANT.format(value=2))
    assert outer(package) == (2, False)


@pytest.mark.thorough
def test_a_kernel_from_its_file_loads_no_compiler(package):
    (package / 'largest.py').write_text(LARGEST)
    ask = (
        'import numpy, sys; from pack.largest import largest; x = largest(numpy.arange(5.0)); '
        'print(x, "numba.np.linalg" in sys.modules, *largest.stats.cache_hits.values()); '
        'largest(numpy.arange(0.0))'
    )
    told = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, '-c', ask], env=environment(package), capture_output=True, text=True
        )
        told.append(done.stdout.split())
        assert 'ValueError: zero-size array' in done.stderr
    assert told == [['4.0', 'True'], ['4.0', 'False', '1']]


@pytest.mark.thorough
def test_two_processes_that_compile_two_forms_at_once_keep_both(package):
    (package / 'twice.py').write_text(TWICE)
    values = [2, 0.75]
    started = [
        subprocess.Popen(
            [sys.executable, '-c', SLOWLY.format(value=value)],
            env=environment(package),
            stdout=subprocess.PIPE,
            text=True,
        )
        for value in values
    ]
    assert [float(process.communicate()[0]) for process in started] == [4.0, 1.5]
    ask = 'from pack.twice import twice; print(twice(2), twice(0.75), twice.stats.cache_misses)'
    done = subprocess.run(
        [sys.executable, '-c', ask],
        env=environment(package),
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ['4', '1.5', 'Counter()']


def test_every_kernel_of_the_package_is_told_apart():
    names = {}
    for file in sorted(kernel_cache.PACKAGE.rglob('*.py')):
        kernels = [
            line for line in file.read_text().split('\n@') if 'cache=True' in line.split('\n')[0]
        ]
        for kernel in kernels:
            name = (file, kernel.split('def ')[1].split('(')[0])
            assert name not in names, f'{name[1]} stands twice in {file}'
            names[name] = kernel
    assert len(names) > 100


@pytest.mark.parametrize(
    'line',
    [
        'import cnc_interp.machine.spindle as s',
        'from cnc_interp.machine import spindle as s',
        'from cnc_interp.machine.spindle import follow',
        '    from cnc_interp.machine import axes, spindle',
        'from cnc_interp.machine import (\n    axes,\n    spindle,\n)',
    ],
)
def test_every_way_to_import_a_file_counts(line, tmp_path):
    file = tmp_path / 'kernel.py'
    file.write_text(f'import os\n{line}\n')
    assert kernel_cache.PACKAGE / 'machine' / 'spindle.py' in kernel_cache.sources(file)


def test_the_users_folder_wins(monkeypatch):
    monkeypatch.setenv(kernel_cache.FOLDER, 'mine')
    locator = kernel_cache.KernelLocator(kernel_cache.PACKAGE / 'core' / 'jet.py')
    assert Path(locator.get_cache_path()) == Path('mine/core')


def test_a_kernel_outlives_the_module_of_a_type_that_it_took(package):
    """After an update, files kept before name modules that are not there any more."""
    (package / 'size.py').write_text(IMPORT + '@njit(cache=True)\ndef size(p):\n    return p.x\n')

    def ask(module):
        point = 'from typing import NamedTuple\nclass Point(NamedTuple):\n    x: int\n'
        (package / f'{module}.py').write_text(point)
        words = (
            f'from pack.size import size; from pack.{module} import Point; print(size(Point(3)))'
        )
        return subprocess.run(
            [sys.executable, '-c', words],
            env=environment(package),
            capture_output=True,
            text=True,
            check=False,
        )

    assert ask('shape').stdout == '3\n'
    (package / 'shape.py').unlink()
    found = ask('form')
    assert found.stdout == '3\n', found.stderr
