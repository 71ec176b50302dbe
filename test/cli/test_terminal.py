"""Names in files and messages cannot control the terminal."""

import io
import os
import pty
import subprocess
import sys
from types import SimpleNamespace

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.analysis.diagnosis.live import Agreement, Obstacle
from inverse_dynamics_node.cli import live_view
from inverse_dynamics_node.cli.main import main
import numpy as np
import pytest
from robot_files import ROOT, STANFORD

ESCAPE = '\x1b]0;title\x07\x1b[2J\r'
C1 = '\x9b2J\u202e'
"""Permitted in XML, which excludes the others: begins an escape sequence, turns text around."""
MARKUP = '[red]m[/red] [/x] :smile:'


def hostile_urdf(path):
    text = STANFORD.read_text().replace('stanford', f'stanford{C1}&#10;No warnings.')
    path.write_text(text.replace('joint_2', f'joint_2{C1}{MARKUP}').replace('<limit', '<limit '))
    return str(path)


def assert_harmless(text, allowed=''):
    for character in text.replace('\r\n', '\n'):
        assert character.isprintable() or character in f'\n{allowed}', repr(text)


def write_table(path, name, rows=400):
    """Write states of two joints and of one with an odd name."""
    times = np.arange(rows) / 100.0
    header = ','.join(f'{joint}.{kind}' for kind in ('position', 'effort') for joint in
                      ('joint_1', 'joint_2', f'"{name}"'))  # fmt: skip
    waves = np.sin(np.outer(times, np.arange(1, 7)))
    lines = [','.join(map(str, row)) for row in np.column_stack([times, waves])]
    header = header.replace('".position', '.position"').replace('".effort', '.effort"')
    path.write_text('\n'.join([f'time,{header}', *lines]), newline='')


def test_a_description_cannot_control_the_terminal(here, capsys):
    urdf = hostile_urdf(here / 'arm.urdf')
    (here / 'move.yaml').write_text(
        'joint_names: [nope]\npoints: [{positions: [0], time_from_start: 0}]'
    )
    assert main(['check', urdf]) == 0
    assert main(['effort', urdf, 'move.yaml', '--no-picture']) == 1
    output = capsys.readouterr()
    assert r'joint_2\x9b2J\u202e' in output.out
    assert r'\x9b' in output.err
    assert '\nNo warnings.' not in output.out.replace('\n\nNo warnings.', '')
    assert_harmless(output.out + output.err)


@pytest.mark.parametrize('command', ['effort', 'compare', 'identify'])
def test_a_recording_cannot_control_the_terminal(command, here, capsys):
    write_table(here / 'run.csv', f'joint{ESCAPE}{C1}')
    main([command, str(STANFORD), 'run.csv', '--no-picture'])
    (here / 'bad.csv').write_text(f'"{ESCAPE}\nfine"\n1\n', newline='')
    assert main([command, str(STANFORD), 'bad.csv', '--no-picture']) == 1
    output = capsys.readouterr()
    assert '\\x1b' in output.out + output.err
    assert '\\x1b' in output.err.splitlines()[-1]
    assert_harmless(output.out + output.err)


def test_a_terminal_shows_progress_without_names_that_control_it(here):
    urdf = hostile_urdf(here / 'arm.urdf')
    master, slave = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, '-m', 'inverse_dynamics_node.cli.main', 'check', urdf],
        env={**os.environ, 'PYTHONPATH': str(ROOT), 'TERM': 'xterm', 'COLUMNS': '160'},
        stdout=slave,
        stderr=slave,
    )
    os.close(slave)
    data = b''
    while chunk := read(master):
        data += chunk
    os.close(master)
    assert process.wait(120) == 0
    text = data.decode().replace('\r\x1b[K', '')  # clears the line with the progress
    assert 'computing poses' in text
    assert '\\x9b2J\\u202e' in text
    assert_harmless(text, '\r')


def read(master):
    try:
        return os.read(master, 65536)
    except OSError:  # the other end is closed
        return b''


def hostile_observer():
    diagnostics = pytest.importorskip('inverse_dynamics_node.ros.diagnostics')
    robot = load_urdf(STANFORD.read_text().replace('joint_2', f'joint_2{C1}{MARKUP}'))
    odd = f'x{ESCAPE}{C1}{MARKUP}\nforged'
    keys = {
        'loop': ('state', 'mode'),
        'other nodes': ('commands', 'subscribers of the commands'),
        'efforts': ('receivers',),
        'model': ('payload',),
    }
    level = diagnostics.Level.ERROR
    status = diagnostics.NodeStatus(
        {
            name: diagnostics.Part(level, odd, dict.fromkeys(found, odd) | {'receivers': '1'})
            for name, found in keys.items()
        }
    )
    sample = SimpleNamespace(q=np.zeros(6), measured=np.zeros(6), modelled=np.zeros(6),
                             commands=np.zeros(6))  # fmt: skip
    return SimpleNamespace(name=odd, robot=robot, status=status), sample


def test_a_node_cannot_control_the_terminal_of_watch(monkeypatch):
    Console = pytest.importorskip('rich.console').Console
    observer, sample = hostile_observer()
    agreement = Agreement(Obstacle.NODE_STATE, reason=f'{ESCAPE}{C1}\nforged')
    output = io.StringIO()
    output.isatty = lambda: True
    monkeypatch.setenv('COLUMNS', '200')
    monkeypatch.setenv('TERM', 'xterm')
    monkeypatch.setattr(sys, 'stdout', output)
    Console(highlight=False).print(live_view.screen(observer, sample, agreement))
    text = output.getvalue()
    assert '\\x9b2J' in text
    assert '[red]m[/red] [/x] :smile:' in text
    assert '\x1b]' not in text
    assert '\x1b[2J' not in text
    assert_harmless(text, '\x1b')
    line = live_view.as_line(observer, agreement)
    assert_harmless(line)
    assert '\n' not in line


def test_a_name_that_is_not_utf8_is_escaped(here, capsys):
    name = b'bad\xff.urdf'.decode(errors='surrogateescape')
    assert main(['check', name]) == 1
    assert r'bad\udcff.urdf' in capsys.readouterr().err
