"""The examples of docs/library.md print what stands in their last comments; names load late."""

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


def test_there_are_five_examples():
    assert len(EXAMPLES) == PAGE.count('```python') == 5


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
    with pytest.raises(AttributeError, match='no_such_name'):
        cnc_interp.no_such_name
    script = "import sys, cnc_interp; print([x for x in sys.modules if x.startswith('cnc_')])"
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True)
    assert eval(done.stdout) == ['cnc_interp']
