"""
Builds by colcon and wheels: the executables are found, and the node starts.

With colcon, `ros2 run` finds them; a wheel needs no ROS but that from the package index.
"""

import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
import sysconfig

from node_process import shared_memory_of
import pytest
from release import problems_of_sdist, problems_of_wheel
from robot_files import ROOT

README = (ROOT / 'README.md').read_text()
COLCON = Path(sysconfig.get_path('scripts')) / 'colcon'
# Starts the executable at the path where `ros2 run` looks for it.
START = """
. install/setup.sh
prefix=$(python3 -c 'import ament_index_python as a;
print(a.get_package_prefix("inverse_dynamics_node"))')
exec "$prefix/lib/inverse_dynamics_node/inverse_dynamics_node" --ros-args \
    -p robot_description_file:="$prefix/share/inverse_dynamics_node/config/stanford.urdf"
"""


def copy_sources(folder):
    ignore = shutil.ignore_patterns('.*', '__pycache__', '*.egg-info', 'build', 'install', 'log')
    shutil.copytree(ROOT, folder, ignore=ignore)


def runner(folder, environment):
    """Return a function that runs a command in a folder and waits for its end."""

    def run(*command):
        return subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, timeout=600
        )

    return run


def shared_memory_of_a_node(command, folder, environment):
    """Start the node, end it when it waits for joint states; return its shared memory."""
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    lines, used = [], None
    for line in process.stdout:  # ends when the process does
        lines.append(line)
        if 'no command yet' in line:
            used = shared_memory_of(process.pid)
            process.send_signal(signal.SIGINT)
    assert process.wait(120) == 0, lines
    assert any("robot 'stanford', 20.8 kg" in line for line in lines), lines
    return used


@pytest.mark.skipif(not COLCON.exists(), reason='colcon is not installed')
@pytest.mark.parametrize(
    'options',
    [
        pytest.param('', id='copy'),
        pytest.param(' --symlink-install', id='symlink', marks=pytest.mark.long),
    ],
)
def test_documented_build_starts_and_puts_the_command_on_the_path(tmp_path, domain_id, options):
    """The second line of the README, with ROS from the package index in place of rosdep."""
    _, build = README.split('```sh\ncd ~/ros2_ws && ')[1].split('```')[0].splitlines()
    build, source = build.split(' && source ')
    assert source == 'install/setup.bash'
    copy_sources(tmp_path / 'src' / 'inverse_dynamics_node')
    environment = {**os.environ, 'PATH': f'{COLCON.parent}:{os.environ["PATH"]}'}
    environment['ROS_DOMAIN_ID'] = str(domain_id)
    page = (ROOT / 'doc' / 'first_hour.md').read_text()
    terminal = page.split('# needs a colcon build\n')[1].split('```')[0]
    lines = [
        f'{build}{options} && source {source}',
        terminal.replace('~/ros2_ws', '.'),
        'inverse_dynamics --version && ls examples config',
        'type -p inverse_dynamics inverse_dynamics_node',
        f'{tmp_path}/install/inverse_dynamics_node/lib/*/inverse_dynamics_node --version',
    ]
    result = runner(tmp_path, environment)('bash', '-e', '-c', '\n'.join(lines))
    assert result.returncode == 0, result.stderr
    declared = (ROOT / 'setup.py').read_text().split("version='")[1].split("'")[0]
    for name in ('inverse_dynamics', 'inverse_dynamics_node'):
        assert f'{tmp_path}/install/inverse_dynamics_node/bin/{name}\n' in result.stdout
        assert f'{name} {declared}\n' in result.stdout
    assert {'park.py', 'stanford.urdf'} <= {*result.stdout.split()}
    # Without shared memory, local_udp.xml is installed.
    assert shared_memory_of_a_node(['sh', '-c', START], tmp_path, environment) == []


@pytest.fixture(scope='module')
def wheel(tmp_path_factory):
    """Build an sdist from a copy of the sources, and a wheel from the sdist."""
    folder = tmp_path_factory.mktemp('release')
    copy_sources(folder / 'sources')
    subprocess.run(
        [sys.executable, 'setup.py', '--quiet', 'sdist', '--dist-dir', folder],
        cwd=folder / 'sources',
        check=True,
        timeout=300,
    )
    (sdist,) = folder.glob('*.tar.gz')
    assert problems_of_sdist(sdist) == []
    options = ['--quiet', '--no-deps', '--wheel-dir', folder]
    subprocess.run(
        [sys.executable, '-m', 'pip', 'wheel', *options, sdist],
        cwd=folder,
        check=True,
        timeout=300,
    )
    (wheel,) = folder.glob('*.whl')
    return wheel


# What a sourced ROS, or the environment of these tests, would add.
FOREIGN = ('PYTHONPATH', 'LD_LIBRARY_PATH', 'AMENT_PREFIX_PATH', '_ROS_WHEELS_BOOTSTRAP_COMPLETE')


@pytest.mark.long
def test_the_wheel_runs_in_an_empty_environment(wheel, tmp_path, domain_id):
    assert problems_of_wheel(wheel) == []
    environment = {name: value for name, value in os.environ.items() if name not in FOREIGN}
    environment['ROS_DOMAIN_ID'] = str(domain_id)
    python = Path(sys.base_prefix, 'bin', f'python3.{sys.version_info.minor}')
    subprocess.run([python, '-m', 'venv', tmp_path / 'venv'], check=True, env=environment)
    folder = tmp_path / 'venv' / 'bin'
    urdf = tmp_path / 'venv/share/inverse_dynamics_node/config/stanford.urdf'

    def run(name, *arguments):
        return runner(tmp_path, environment)(folder / name, *arguments)

    result = run('pip', 'install', '--quiet', f'{wheel}[cli]')
    assert result.returncode == 0, result.stderr
    result = run('inverse_dynamics', 'check', urdf)
    assert result.stdout.startswith('Usable, no warnings. '), result.stderr
    result = run('inverse_dynamics', 'effort', urdf, ROOT / 'doc' / 'stanford_pick.yaml')
    assert (tmp_path / 'stanford_pick_efforts.png').exists(), result.stderr
    result = run('inverse_dynamics', 'demo', urdf)
    assert result.returncode == 1
    advice = result.stderr.partition("pip install '")[2].partition("'")[0]
    assert advice == '.[ros,demo]', result.stderr
    result = run('pip', 'install', '--quiet', advice.replace('.', str(wheel), 1))
    assert result.returncode == 0, result.stderr
    result = run('inverse_dynamics', 'demo', urdf)
    # On a busy machine, the demo may fail.
    assert re.search(r'^(PASSED|FAILED): ', result.stdout, re.M), result.stdout + result.stderr
    given = f'robot_description_file:={urdf}'
    command = [folder / 'inverse_dynamics_node', '--ros-args', '-p', 'dry_run:=true', '-p', given]
    assert shared_memory_of_a_node(command, tmp_path, environment) is not None
