"""The settings of the core, declared as parameters of the node."""

from dataclasses import fields
import math

from inverse_dynamics_node.control.settings import setting, Settings


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
