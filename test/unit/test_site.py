"""The site of ./cnc docs has every page, every name of the library, and what its fields mean."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import cnc_interp
from cnc_interp import problems

pytest.importorskip('mkdocs', reason='needs the optional part docs')
ROOT = Path(__file__).parents[2]


@pytest.mark.thorough
def test_site_has_all_pages_and_the_library(tmp_path):
    command = [sys.executable, '-m', 'mkdocs', 'build', '--quiet', '--site-dir', str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0 and 'ERROR' not in done.stderr, done.stderr
    for page in (ROOT / 'docs').rglob('*.md'):
        name = page.relative_to(ROOT / 'docs').with_suffix('.html')
        made = tmp_path / (name.with_name('index.html') if page.stem == 'README' else name)
        assert made.is_file(), page
    law = (tmp_path / 'how_it_works' / 'feedrate.html').read_text()
    assert law.count('<math') > 20 and 'arithmatex' not in law and '$$' not in law
    api = (tmp_path / 'api.html').read_text()
    shown = set(re.findall(r'<h[23] id="([^"]+)"', api))
    assert {f'cnc_interp.{name}' for name in cnc_interp.__all__} <= shown
    assert {f'cnc_interp.problems.{name}' for name in problems.__all__} - shown <= {
        'cnc_interp.problems.paths'  # a module has this name, too
    }
    assert 'cnc_interp.problems.paths.score' in shown
    assert 'The path of the axes and the motion law along it, in parts.' in api  # behind #:
