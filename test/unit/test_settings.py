"""The settings of the core, declared as parameters of the node."""

from dataclasses import fields
import math

from inverse_dynamics_node.control.settings import setting, Settings, StalePolicy
import pytest


def test_values_are_declared_as_in_a_parameter_file():
    declared = {each.name: each.metadata['default'] for each in fields(Settings)}
    assert declared['mode'] == 'inverse_dynamics'
    assert declared['on_stale_state'] == 'zero'
    assert Settings().effort_limits == math.inf
    assert declared['effort_limits'] == 0.0
    assert declared['kp'] == Settings().kp == 100.0


def test_words_and_ranges_are_kept():
    declaration = setting(1.0, 'a', 'b', unit='s').metadata
    assert declaration == {'default': 1.0, 'summary': 'a', 'details': 'b', 'unit': 's'}


@pytest.mark.parametrize(
    ('default', 'in_file'), [(2.0, 2.0), (math.inf, 0.0), (StalePolicy.HOLD, 'hold'), (True, True)]
)
def test_a_setting_keeps_its_value_and_declares_that_of_a_parameter_file(default, in_file):
    declared = setting(default, 'summary')
    assert declared.default is default
    assert declared.metadata['default'] == in_file
