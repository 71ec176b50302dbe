"""Rules for all Markdown files: width, code blocks, links and paths."""

import inspect
import re

from inverse_dynamics_node.dynamics import equations
import pytest
from robot_files import ROOT

WIDTH = 100
PAGES = [*sorted(ROOT.glob('*.md')), *sorted((ROOT / 'doc').rglob('*.md'))]
NOTATION = (ROOT / 'doc' / 'notation.md').read_text()
TEMPLATES = sorted((ROOT / 'benchmarks').glob('*.md'))


def prose_of(text):
    """Yield number and text of each line that is not in a code block, a table or a lone link."""
    is_code = False
    for number, line in enumerate(text.splitlines(), start=1):
        if line.lstrip().startswith('```'):
            is_code = not is_code
        elif not (is_code or line.startswith('|') or re.fullmatch(r'!?\[[^]]*\]\(\S*\)', line)):
            yield number, line


def name_of(path):
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize('path', TEMPLATES + PAGES, ids=name_of)
def test_prose_is_at_most_100_columns_wide(path):
    long = [number for number, line in prose_of(path.read_text()) if len(line) > WIDTH]
    assert not long, f'{name_of(path)}: lines {long} are longer than {WIDTH} columns'


@pytest.mark.parametrize('path', PAGES, ids=name_of)
def test_code_blocks_are_fenced_and_have_a_language(path):
    fences = re.findall(r'^ *```(.*)$', path.read_text(), re.M)
    assert len(fences) % 2 == 0
    assert all(fences[::2])
    assert not any(fences[1::2])
    without_fences = '\n'.join(line for _, line in prose_of(path.read_text()))
    assert not re.search(r'(?:^|\n\n)    \S.*', without_fences)


@pytest.mark.parametrize('path', PAGES, ids=name_of)
def test_links_lead_to_files_and_headings(path):
    for link in re.findall(r'\]\(([^):]+)\)', path.read_text()):
        file, _, heading = link.partition('#')
        target = path.parent / file if file else path
        assert target.resolve().exists(), link
        if heading:
            titles = re.findall(r'^#+ (.*)$', target.read_text(), re.M)
            assert heading in [anchor(title) for title in titles], link


@pytest.mark.parametrize('path', PAGES, ids=name_of)
def test_files_in_the_text_exist(path):
    for name in re.findall(r'`((?:test|config|doc|benchmarks)/[\w./]+)`', path.read_text()):
        assert (ROOT / name).exists(), name


def anchor(title):
    """Return the anchor that GitHub gives a heading."""
    return re.sub(r'[^\w -]', '', title.lower()).replace(' ', '-')


def test_notation_lists_the_functions_of_each_equation():
    rows = re.findall(r'^\| \((\d+)\) \|.*\| (.*) \|$', NOTATION, re.M)
    assert [int(number) for number, _ in rows] == [31, 36, 37, 40, 44, 41, 42, 45, 46, 47]
    for number, functions in rows[1:]:
        for name in re.findall(r'`(\w+)`', functions):
            assert f'({number})' in getattr(equations, name).__doc__ or name == 'net_force'


def test_notation_shows_the_recursion():
    blocks = re.findall(r'```python\n(.*?)```', NOTATION, re.S)
    source = inspect.getsource(equations)
    assert blocks == [source[source.index('class Link(') :]]


def test_log_lines_of_the_troubleshooting_page_are_in_the_code():
    page = (ROOT / 'doc' / 'troubleshooting.md').read_text()
    code = ''.join(path.read_text() for path in (ROOT / 'inverse_dynamics_node').rglob('*.py'))
    # Texts are split over lines, and names and numbers are filled in.
    code = re.sub(r"""['"]\s+f?['"]""", '', code)
    code += re.sub(r'\{[^{}]*\}', '...', code)
    tables = re.findall(r'^\| (?:log|watch) \|.*\n(?:\|.*\n)+', page, re.M)
    lines = [line for table in tables for row in table.splitlines()[2:] for line in logged(row)]
    assert len(lines) > 30
    for line in lines:
        for part in line.split('...'):
            assert part.strip(" :;,'()") in code, line


def logged(row):
    """Return the log lines in the first cell of a row."""
    return re.findall(r'`([^`]+)`', row.split(' | ')[0])


def test_site_has_every_page():
    index = ROOT / 'doc' / 'index.md'
    pages = re.findall(r'^([a-z_/]+)$', index.read_text(), re.M)
    sources = [*{*(ROOT / 'doc').rglob('*.md')} - {index}, ROOT / 'doc' / 'api.rst']
    assert sorted(pages) == sorted(
        str(path.relative_to(ROOT / 'doc').with_suffix('')) for path in sources
    )
