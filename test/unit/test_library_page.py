"""The examples of docs/library.md print what their last comments say; names load late."""

import contextlib
import io
import re
import subprocess
import sys
from pathlib import Path

import pytest

import cnc_interp

PAGE = (Path(__file__).parents[2] / 'docs' / 'library.md').read_text()
EXAMPLES = re.findall(r'^## ([^\n]+)\n(?:(?!^## ).)*?^```python\n(.*?)^```$', PAGE, re.M | re.S)


def test_every_example_of_the_page_is_run():
    assert len(EXAMPLES) == PAGE.count('```python') == 3


@pytest.mark.parametrize(('title', 'code'), EXAMPLES)
def test_example(title, code):
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, title, 'exec'), {})
    prints = re.search(r'((?:^# .*\n)+)\Z', code, re.M)[1]
    assert printed.getvalue() == prints.replace('# ', '')


def test_names_of_the_library_are_there_and_no_import_waits_for_them():
    for name in cnc_interp.__all__:
        assert getattr(cnc_interp, name).__doc__, name
    listed = [name for names in cnc_interp._HOMES.values() for name in names.split()]
    assert sorted(listed) == sorted(cnc_interp.__all__)
    assert set(cnc_interp.__all__) <= set(dir(cnc_interp)), 'completion offers them'
    with pytest.raises(AttributeError, match='no_such_name'):
        cnc_interp.no_such_name
    script = "import sys, cnc_interp; print([x for x in sys.modules if x.startswith('cnc_')])"
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True)
    assert eval(done.stdout) == ['cnc_interp']


def test_the_first_call_takes_names_and_paths_and_says_what_is_wrong(tmp_path):
    text = 'G1 X0 Y0 F3000\nX40\nY20\n'
    (tmp_path / 'part.ngc').write_text(text)
    wide = {'contour_tolerance': 1e-3, 'orientation_tolerance': 1e-3}
    plan = cnc_interp.plan(text, 'xyz', **wide)
    again = cnc_interp.plan(tmp_path / 'part.ngc', cnc_interp.Machine.load('xyz'))
    assert again.cycle_time > plan.cycle_time > 60e-3 / 0.05, 'a larger tolerance is faster'
    assert plan.length == pytest.approx(60e-3, abs=2e-3)
    assert f'{plan.cycle_time:.3f} s' in repr(plan)
    drawn = {(one.name, one.yaxis): one.y for one in plan.plot().data}
    assert (
        max(drawn['X', 'y']) == pytest.approx(40.0, abs=1.0) and abs(drawn['X', 'y3']).max() > 0.9
    )
    for words, wrong, told in (
        (([1],), {}, 'program must be text'),
        ((text, 3), {}, 'machine must be a name'),
        ((text,), {'contour_tolerence': 1e-5}, 'did you mean contour_tolerance'),
    ):
        with pytest.raises(TypeError, match=told):
            cnc_interp.plan(*words, **wrong)
    for words, told in ('missing.ngc', 'missing.ngc'), ('G1 X10 F3000' + ' ' * 300, 'no motion'):
        with pytest.raises(cnc_interp.InterpError, match=told):
            cnc_interp.plan(words)
    assert str(plan.check()).endswith('proven')
