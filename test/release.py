"""
Builds sdist and wheel in dist/, and checks what they contain, for `make release`.

Publish with `twine upload dist/*`, and with `bloom-release` for ROS, after
`catkin_prepare_release` has set the version and the title of the changelog.
"""

from pathlib import Path
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile

ROOT = Path(__file__).resolve().parents[1]
NAME = 'inverse_dynamics_node'
SHARED = (
    'LICENSE',
    'package.xml',
    'config/inverse_dynamics.yaml',
    'config/robots/ur.yaml',
    'config/stanford.urdf',
    'examples/hold_still.py',
    'launch/inverse_dynamics.launch.xml',
)
"""Installed in the share directory of the package; the same paths as in the source tree."""
LIBRARY = ('py.typed', 'ros/local_udp.xml', 'cli/main.py', 'node/main.py')


def versions():
    """Return the version in each file that must contain it: bloom reads two, citations one."""
    patterns = {
        'setup.py': r"^    version='([^']+)'",
        'package.xml': '<version>([^<]+)</version>',
        'CITATION.cff': r'^version: (\S+)',
    }
    return {
        name: re.search(pattern, (ROOT / name).read_text(), re.M)[1]
        for name, pattern in patterns.items()
    }


def changelog_title():
    """Return the title of the first section of the changelog."""
    return re.search(r'^(.+)\n-+\n', (ROOT / 'CHANGELOG.rst').read_text(), re.M)[1]


def problems_of_texts():
    """List what contradicts, or must not be published."""
    found, title = versions(), changelog_title()
    problems = [f'versions differ: {found}'] if len(set(found.values())) > 1 else []
    if title != 'Forthcoming' and title.split()[0] != found['package.xml']:
        problems.append(f"CHANGELOG.rst begins with '{title}', expected {found['package.xml']}")
    return problems


def warnings_of_texts():
    """List what must change before a release is published."""
    warnings = [
        f'{name} has an address that does not exist: {address}'
        for name in ('package.xml', 'setup.py', 'README.md', 'CITATION.cff')
        for address in sorted(set(re.findall(r'[\w.@:/-]+\.example\b', (ROOT / name).read_text())))
    ]
    if changelog_title() == 'Forthcoming':
        warnings.append('CHANGELOG.rst begins with Forthcoming: run catkin_prepare_release')
    return warnings


def problems_of_wheel(path):
    """List the files that a wheel lacks."""
    with zipfile.ZipFile(path) as wheel:
        names = wheel.namelist()
    folder = path.name.split('-py3')[0]
    expected = [f'{folder}.data/data/share/{NAME}/{name}' for name in SHARED]
    expected += [f'{NAME}/{name}' for name in LIBRARY]
    expected += [f'{folder}.data/data/share/ament_index/resource_index/packages/{NAME}']
    problems = [f'{path.name} lacks {name}' for name in expected if name not in names]
    if not any(re.match(rf'{folder}\.dist-info/(licenses/)?LICENSE$', name) for name in names):
        problems.append(f'{path.name} lacks the licence')
    return problems + [f'{path.name} contains {x}' for x in names if x.startswith('test/')]


def problems_of_sdist(path):
    """List the files that an sdist lacks."""
    with tarfile.open(path) as sdist:
        names = sdist.getnames()
    folder = path.name.removesuffix('.tar.gz')
    expected = [*SHARED, *(f'{NAME}/{name}' for name in LIBRARY), 'CHANGELOG.rst', 'README.md']
    return [f'{path.name} lacks {x}' for x in expected if f'{folder}/{x}' not in names]


def main():
    """Build and check; return the exit code."""
    problems = problems_of_texts()
    dist = ROOT / 'dist'
    shutil.rmtree(dist, ignore_errors=True)
    # The wheel is built from the sdist, which is therefore complete.
    subprocess.run([sys.executable, '-m', 'build', '--outdir', dist, ROOT], check=True)
    (sdist,), (wheel,) = dist.glob('*.tar.gz'), dist.glob('*.whl')
    problems += problems_of_sdist(sdist) + problems_of_wheel(wheel)
    check = [sys.executable, '-m', 'twine', 'check', '--strict', sdist, wheel]
    problems += ['twine check failed'] if subprocess.run(check, check=False).returncode else []
    for warning in warnings_of_texts():
        print(f'before publishing: {warning}')
    for problem in problems:
        print(f'problem: {problem}')
    print('FAILED' if problems else f'PASSED: {sdist.name}, {wheel.name}')
    return bool(problems)


if __name__ == '__main__':
    sys.exit(main())
