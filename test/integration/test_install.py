"""The same tree by colcon: the executable is where `ros2 run` looks for it, and starts."""

import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import sysconfig

import pytest
from robot_files import ROOT

COLCON = Path(sysconfig.get_path('scripts')) / 'colcon'
# Where `ros2 run` looks, and what it needs to have found there.
START = """
. install/setup.sh
prefix=$(python3 -c 'import ament_index_python as a;
print(a.get_package_prefix("inverse_dynamics_node"))')
exec "$prefix/lib/inverse_dynamics_node/inverse_dynamics_node" --ros-args \
    -p robot_description_file:="$prefix/share/inverse_dynamics_node/config/stanford.urdf"
"""


@pytest.mark.skipif(not COLCON.exists(), reason='colcon is not installed')
@pytest.mark.parametrize('options', [[], ['--symlink-install']], ids=['copy', 'symlink'])
def test_colcon_build_starts(tmp_path, domain_id, options):
    source = tmp_path / 'src' / 'inverse_dynamics_node'
    ignore = shutil.ignore_patterns('.*', '__pycache__', '*.egg-info', 'build', 'install', 'log')
    shutil.copytree(ROOT, source, ignore=ignore)
    environment = {
        **os.environ,
        'PATH': f'{Path(sys.executable).parent}:{os.environ["PATH"]}',
        'ROS_DOMAIN_ID': str(domain_id),
    }
    subprocess.run(
        [COLCON, 'build', *options], cwd=tmp_path, env=environment, check=True, timeout=300
    )
    scripts = tmp_path / 'install/inverse_dynamics_node/lib/inverse_dynamics_node'
    assert (scripts / 'inverse_dynamics').exists()  # for `ros2 run`
    process = subprocess.Popen(
        ['sh', '-c', START],
        cwd=tmp_path,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    lines = []
    for line in process.stdout:  # ends with the process, at the latest
        lines.append(line)
        if 'no command yet' in line:
            process.send_signal(signal.SIGINT)
    assert process.wait(60) == 0, lines
    assert any("robot 'stanford', 20.8 kg" in line for line in lines), lines
    command = '. install/setup.sh; install/inverse_dynamics_node/lib/*/inverse_dynamics_node '
    version = subprocess.run(
        ['sh', '-c', f'{command} --version'],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    declared = (ROOT / 'setup.py').read_text().split("version='")[1].split("'")[0]
    assert version.stdout == f'inverse_dynamics_node {declared}\n', version.stderr
