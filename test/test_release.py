"""The files that bloom, rosdep and the package index read are valid and agree with each other."""

import re

from packaging.requirements import Requirement
import pytest
from release import problems_of_texts, warnings_of_texts
from robot_files import ROOT
import yaml

SETUP = (ROOT / 'setup.py').read_text()
CHANGELOG = ROOT / 'CHANGELOG.rst'


def declared(name):
    return re.search(rf"^    {name}='([^']*)'", SETUP, re.M)[1]


def test_manifest_is_valid_and_agrees_with_setup():
    catkin_pkg = pytest.importorskip('catkin_pkg.package')
    package = catkin_pkg.parse_package(str(ROOT))  # raises if it is invalid
    warnings = []
    package.validate(warnings=warnings)
    assert warnings == []
    assert package.version == declared('version')
    assert [person.name for person in package.maintainers] == [declared('maintainer')]
    assert [person.name for person in package.authors] == [declared('author')]
    assert package.licenses[0] == declared('license')


def test_versions_and_changelog_agree():
    assert problems_of_texts() == []
    assert yaml.safe_load((ROOT / 'CITATION.cff').read_text())['cff-version'] == '1.2.0'
    # The manifest needs an address; whoever publishes the package puts a real one there.
    invented = [warning for warning in warnings_of_texts() if 'address' in warning]
    assert [warning.partition(' ')[0] for warning in invented] == ['package.xml']


def test_libraries_of_the_package_index_are_dependencies_of_the_manifest():
    text = (ROOT / 'package.xml').read_text()
    required = re.search(r'install_requires=\[(.*?)\]', SETUP, re.S)[1]
    names = [Requirement(each).name for each in re.findall("'([^']+)'", required)]
    assert len(names) >= 5
    for name in names:
        assert re.search(rf'<exec_depend>python3-{name}(-pip)?</exec_depend>', text), name


def test_bloom_can_read_the_changelog():
    changelogs = pytest.importorskip('catkin_pkg.changelog')
    text = CHANGELOG.read_text()
    # catkin_prepare_release replaces this title; bloom reads the result.
    assert text.count('\nForthcoming\n-----------\n') == 1
    title = f'{declared("version")} (2026-11-22)'
    released = text.replace('Forthcoming\n-----------', f'{title}\n{"-" * len(title)}')
    changelog = changelogs.Changelog('inverse_dynamics_node')
    changelogs.populate_changelog_from_rst(changelog, released)
    (version,) = [version for version, _, _ in changelog.foreach_version()]
    assert version == declared('version')
    items = changelog.get_content_of_version(version)
    lists = [item for item in items if isinstance(item, changelogs.BulletList)]
    count = sum(len(each.bullets) for each in lists)
    assert count == len(re.findall(r'^\* ', text, re.M)) > 20
