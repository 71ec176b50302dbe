"""The files generated from the declaration of the parameters."""

import re
import subprocess
import sys

from inverse_dynamics_node.node.help import parameter_files, parameter_table
from inverse_dynamics_node.node.parameters import (
    LOCKED_POSITION,
    PARAMETERS,
)
from inverse_dynamics_node.node.ros_parameters import _REMOVED
import pytest
from robot_files import ROOT


@pytest.mark.parametrize('path', parameter_files(), ids=str)
def test_the_generated_parts_are_up_to_date(path):
    assert (ROOT / path).read_text() == parameter_files()[path], 'run `make parameters`'


def test_the_generator_lists_the_files_that_change_and_needs_no_ros():
    code = (
        "import sys; sys.modules.update(dict.fromkeys(['rclpy', 'rcl_interfaces']));"
        'from inverse_dynamics_node.node.help import main; main()'
    )
    result = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
    assert (result.returncode, result.stdout, result.stderr) == (0, '', '')


def test_cells_of_the_table_are_short():
    for row in parameter_table().splitlines():
        for cell in row.strip('|').split('|'):
            assert len(cell) < 120


@pytest.mark.parametrize('name', PARAMETERS)
def test_every_default_is_valid_and_described(name):
    parameter = PARAMETERS[name]
    parameter.check(parameter.default)
    assert parameter.summary
    for text in (parameter.summary, parameter.details):
        assert not text.endswith('.')
        assert text.count('`') % 2 == 0
    # Each number is a quantity with a unit, except for factors and priorities.
    factors = ('effort_scale', 'measured_effort_scale', 'friction_scale', 'load_friction')
    has_none = name in (*factors, 'guiding_speed', 'drive_coupling', 'thread_priority')
    assert bool(parameter.unit) == (parameter.kind.is_numeric and not has_none)


def test_the_unit_follows_the_first_sentence():
    assert PARAMETERS['kp'].description == 'Position gain of computed_torque [1/s^2]'
    description = PARAMETERS['effort_limits'].description
    assert description.startswith('Effort limits in addition to those of the URDF [N m, N]. 0:')
    assert re.search(r'reports it \[rad, m\]\. ', LOCKED_POSITION.description)


@pytest.mark.parametrize('name', _REMOVED)
def test_the_changelog_names_each_removed_parameter(name):
    assert name not in PARAMETERS
    assert f'``{name}``' in (ROOT / 'CHANGELOG.rst').read_text().partition('0.1.0, the')[0]
