"""Node and driver on two machines, with a network between them that has faults."""

import os

from fork_server import SERVER
from node_process import PATIENCE
import pytest
from robot_files import ROOT

# Others may have no permission for network namespaces; as root, the program says so.
pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason='only root creates networks')
CODE = """
import sys
sys.path[:0] = ['.', 'test']
from benchmarks.network_faults import main
sys.exit(main())
"""


def suffer(*arguments):
    """Check the promises in a process of its own; return the rows of the table, without head."""
    command = ['-c', CODE, '--seconds', '1', '--repetitions', '1', *arguments]
    result = SERVER.call(command, folder=ROOT, timeout=2.0 * PATIENCE)
    if result.returncode == 2:
        pytest.skip(result.stderr)
    assert result.returncode == 0, result.stderr
    return [line for line in result.stdout.splitlines() if line.startswith('|')][2:]


def test_lost_packets_cause_no_step():
    assert len(suffer('--only', '10 % lost, 50 ms')) == 1


@pytest.mark.long
def test_efforts_return_after_an_outage_without_a_step():
    assert len(suffer('--only', 'down for 0.')) == 4
