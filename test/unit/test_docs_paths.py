"""Files, folders and links that README and docs name are there."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [
    *(ROOT / name for name in ('README.md', 'CONTRIBUTING.md', 'CHANGELOG.md')),
    *sorted((ROOT / 'docs').rglob('*.md')),
    *sorted((ROOT / 'benchmarks').glob('*.md')),
]
#: Folders of the repository; a name that begins with one of them is a path from the root.
TOP = {path.name for path in ROOT.iterdir() if path.is_dir()} - {'out', '.git', '.venv'}
#: Where a shorter name may begin.
BASES = [ROOT, *(p for p in (ROOT / 'cnc_interp').rglob('*') if p.is_dir()), ROOT / 'cnc_interp']
BASES += [ROOT / 'test', ROOT / 'docs', ROOT / 'benchmarks']
SOURCES = {p.name for folder in TOP for p in (ROOT / folder).rglob('*.py')}
WORD = re.compile(r'[\w./*-]+')
LINK = re.compile(r'\]\(([^)#\s]+)[^)]*\)')


def missing(page: Path) -> list[str]:
    """Return what a page names and the repository lacks."""
    text = page.read_text()
    found = []
    for target in LINK.findall(text):
        if '://' not in target and not (page.parent / target).exists():
            found.append(f'link {target}')
    for word in set(WORD.findall(LINK.sub(']', text))):
        name = word.strip('.')
        first, slash, _ = name.partition('/')
        if '*' in name:
            continue
        if name.endswith('.py') and not slash:
            there = name in SOURCES
        elif name.endswith('.py') or (slash and first in TOP):
            there = any((base / name).exists() for base in [*BASES, page.parent])
        else:
            continue
        if not there:
            found.append(name)
    return sorted(found)


NAMED_TEST = re.compile(r'\[(test_\w+)\]\(([^)]+\.py)\)')


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_names_is_there(page):
    assert not missing(page)


def test_rooms_of_the_readme_are_the_folders_of_the_package():
    text = (ROOT / 'README.md').read_text()
    map_ = text[text.index('Packages in `cnc_interp/`') :].split('```')[1]
    named = {room for line in map_.splitlines() for room in re.findall(r'^(?:\w+/ ?)+', line)}
    rooms = {room.strip('/') for names in named for room in names.split()}
    folders = {p.name for p in (ROOT / 'cnc_interp').iterdir() if (p / '__init__.py').exists()}
    assert rooms == folders


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_tests_that_a_page_names_are_in_the_files_that_it_links(page):
    for name, file in NAMED_TEST.findall(page.read_text()):
        assert f'def {name}(' in (page.parent / file).read_text(), f'{file} has no test {name}'


@pytest.mark.parametrize('script', ['cnc', '.ci/run', 'tools/make_wheels', 'tools/bare_system'])
def test_examples_that_scripts_use_exist(script):
    for name in re.findall(r'examples/\w+\.\w+', (ROOT / script).read_text()):
        assert (ROOT / name).exists(), f'{script} uses {name}'


def test_the_texts_stay_short_enough_to_be_read():
    """Words with a letter, in pages and tables; 44,542 before they were condensed."""
    words = [word for page in PAGES for word in page.read_text().split()]
    assert sum(any(map(str.isalpha, word)) for word in words) < 40_000
