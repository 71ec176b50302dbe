"""The command `watch` without a node."""

import re

from inverse_dynamics_node.cli.live_view import CODES
from inverse_dynamics_node.cli.main import main
from inverse_dynamics_node.cli.watch import EPILOG, next_time
import pytest
from robot_files import ROOT


@pytest.mark.parametrize('name', ['im possible', 'arm!', '', '/', 'left//arm', 'arm/', '7axes'])
def test_a_name_that_no_node_can_have_is_rejected(name, capsys):
    with pytest.raises(SystemExit) as error:
        main(['watch', name])
    assert error.value.code == 2
    assert f"'{name}' cannot be the name of a node" in capsys.readouterr().err


def test_a_late_line_is_not_followed_by_another_one_at_once():
    assert next_time(10.0, 1.0, 10.02) == 11.0
    assert next_time(10.0, 1.0, 12.5) == 13.5


def test_exit_codes_are_documented_in_the_help_and_on_the_page():
    pages = EPILOG, (ROOT / 'doc' / 'watch.md').read_text()
    for text, pattern in zip(pages, (r'^ +(\d+)  (.*)', r'^\| (\d+) \| (.*) \|'), strict=True):
        meanings = {int(code): meaning for code, meaning in re.findall(pattern, text, re.M)}
        assert set(meanings) == {*CODES.values(), 1, 2, 130}
        assert len(set(meanings.values())) == len(meanings)
