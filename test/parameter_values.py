"""Checked values of the parameters of the node."""

from inverse_dynamics_node.node.parameters import Configuration, PARAMETERS


def configured(**values):
    """Return the defaults of all parameters, with other values for some of them."""
    given = {name: values.get(name, each.default) for name, each in PARAMETERS.items()}
    return Configuration(**{name: PARAMETERS[name].check(value) for name, value in given.items()})
