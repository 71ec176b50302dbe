"""Metadata, for pip and for colcon."""

from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

package_name = 'inverse_dynamics_node'

# A distribution keeps its second number: 7.1 of rclpy is Jazzy, 9.1 is Kilted.
ros = [
    'ros-jazzy-rclpy[fastrtps]>=7.1.6,<7.2',
    'ros-jazzy-common-interfaces>=5.3.6,<5.4',
    'xacro>=2',
]
kilted = [
    'ros-kilted-rclpy[fastrtps]>=9.1.2,<9.2',
    'ros-kilted-common-interfaces>=5.5.1,<5.6',
    'xacro>=2',
]
cli = ['matplotlib>=3.6.3', 'PyYAML>=6.0.1', 'rich>=13.7.1', 'rosbags>=0.11.7']
collisions = ['coal>=3']  # for `excite`
demo = [*cli, 'mujoco>=3.17']  # earlier versions ignore mimic joints of a URDF
test = [
    'catkin-pkg',
    'colcon-common-extensions',
    'example-robot-data>=6',
    'hypothesis>=6.98',
    'mypy==2.4.*',
    'pin>=2.7',
    'pytest>=7.4',
    'pytest-rerunfailures>=14',
    'pytest-timeout>=2',
    'pytest-xdist>=3',
    'ros-domain-coordinator>=0.12,<0.13',
    'ruff==0.17.*',
]
release = ['build>=1', 'twine>=6']
doc = ['myst-parser>=4', 'sphinx>=8']
mutation = ['hypothesis>=6', 'mutmut==3.8.1', 'pytest>=8']
bench = [
    'example-robot-data>=6',
    'hypothesis>=6',
    'mujoco>=3.1',
    'pin>=3.5',
]

setup(
    name=package_name,
    version='0.1.0',
    packages=find_packages(exclude=['benchmarks', 'test', 'test.*']),
    package_data={package_name: ['py.typed', 'ros/*.xml']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (f'share/{package_name}', ['package.xml', 'LICENSE']),
        (f'share/{package_name}/config', glob('config/*.*')),
        (f'share/{package_name}/config/robots', glob('config/robots/*')),
        (f'share/{package_name}/config/sros2', glob('config/sros2/*')),
        (f'share/{package_name}/examples', glob('examples/*.py')),
        (f'share/{package_name}/launch', glob('launch/*')),
        # `ros2 run` looks here; the console scripts are in bin, which colcon adds to the path.
        (f'lib/{package_name}', glob('scripts/*')),
    ],
    python_requires='>=3.10',
    # ROS is not listed: a sourced ROS must not be shadowed, and the library does not need it.
    # `make test-oldest` tests the oldest versions, which are listed in test/oldest.txt.
    install_requires=[
        'lxml>=5.2.1',
        'numba>=0.58.1',
        'numpy>=1.26.4',
        'scipy>=1.11.4',
        'yourdfpy>=0.0.56',
    ],
    extras_require={
        'ros': ros,
        'kilted': kilted,
        'demo': demo,
        'cli': cli,
        'collisions': collisions,
        'test': test,
        'bench': bench,
        'doc': doc,
        'mutation': mutation,
        'release': release,
    },
    zip_safe=False,
    author='inverse_dynamics_node maintainers',
    maintainer='inverse_dynamics_node maintainers',
    description='ROS 2 node that turns a URDF and joint states into joint efforts, for gravity '
    'compensation, computed torque, joint impedance and feed-forward',
    long_description=Path(__file__).resolve().with_name('README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            f'{package_name} = {package_name}.node.main:run',
            f'inverse_dynamics = {package_name}.cli.main:main',
        ],
    },
)
