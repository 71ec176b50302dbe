"""Loads: payloads, wrenches that end, gravity and the motion of the base."""

import contextlib
from functools import partial
import math

from hypothesis import given
from hypothesis import strategies as st
from inverse_dynamics_node import ConfigurationError, InverseDynamics, load_urdf
from inverse_dynamics_node.control.external_loads import ExternalLoads, IMU_TIMEOUT
from inverse_dynamics_node.control.settings import Settings
import numpy as np
import pytest
from robot_files import STANFORD

Q = np.array([0.3, 1.2, 0.5, 0.4, -0.6, 0.2])
TIP = 'link_6'
INERTIA = np.diag([0.01, 0.02, 0.02])
FLAWED = np.diag([0.1, 0.3, 0.1])
SLENDER = np.diag([0.01, 0.2, 0.3])
DOWN = np.array([0.0, 0.0, -9.80665])


@pytest.fixture
def dynamics():
    return InverseDynamics(load_urdf(STANFORD))


@pytest.fixture
def loads(dynamics):
    loads = ExternalLoads(dynamics)
    loads.update(0.0)
    return loads


PAYLOAD = 2.0, (0.0, 0.1, 0.05), INERTIA


def test_a_payload_acts_until_it_is_removed(loads, dynamics):
    before, other = dynamics.gravity_efforts(Q), InverseDynamics(load_urdf(STANFORD))
    assert loads.set_payload(TIP, *PAYLOAD)
    other.set_payload(TIP, *PAYLOAD)
    for now in (0.1, 0.2):  # a message that is repeated changes nothing
        assert dynamics.gravity_efforts(Q) == pytest.approx(other.gravity_efforts(Q))
        assert dynamics.mass_matrix(Q) == pytest.approx(other.mass_matrix(Q))
        assert not loads.set_payload(TIP, *PAYLOAD)
        loads.update(now)
    assert loads.payloads[TIP].mass == 2.0
    for is_new in (True, False):
        assert loads.set_payload(TIP, 0.0, *PAYLOAD[1:]) is is_new
    assert dynamics.gravity_efforts(Q) == pytest.approx(before)
    assert loads.payloads == {}


@pytest.mark.parametrize('k', range(3))
def test_a_payload_that_differs_in_one_value_is_new(loads, k):
    assert loads.set_payload(TIP, *PAYLOAD)
    assert loads.set_payload(
        TIP, *(1.1 * np.array(x) if i == k else x for i, x in enumerate(PAYLOAD))
    )
    assert loads.update(0.1)


@pytest.mark.parametrize(
    ('change', 'elapsed', 'may_jump'),
    [
        (0.0, 9.0, False),
        (0.19, 0.01, False),
        (0.21, 0.01, True),
        (0.79, 0.04, False),
        (0.1, 0.06, True),
        (0.1, 0.0, True),
        (0.1, -0.01, True),
    ],
)
def test_gravity_jumps_unless_messages_arrive_often_and_differ_little(
    loads, dynamics, change, elapsed, may_jump
):
    loads.set_gravity((0.0, 3.0, -9.0), 1.0)
    assert loads.update(1.0)
    loads.set_gravity((0.0, 3.0 + change, -9.0), 1.0 + elapsed)
    assert loads.update(1.0 + elapsed) is may_jump
    assert dynamics.gravity == pytest.approx([0.0, 3.0 + change, -9.0])


def test_a_wrench_that_was_not_renewed_in_time_is_a_jump(dynamics):
    loads = ExternalLoads(dynamics, Settings(wrench_timeout=0.125))

    def is_jump(now):
        return loads.set_external_wrench(now, TIP, (1.0, 2.0, 3.0), np.zeros(3))

    assert is_jump(5.0)
    assert [is_jump(now) for now in (5.0, 5.1, 5.225, 5.4, 5.5)] == [
        False,
        False,
        False,
        True,
        False,
    ]
    assert is_jump(1.0)  # the clock was set back
    for now in (1.0, 1.2):
        loads.update(now)
    assert is_jump(1.05)  # it has begun to fade
    assert not is_jump(1.1)
    assert loads.update(1.1)  # although the last one was renewed in time
    assert not loads.update(1.1)


def test_the_motion_of_the_base_replaces_gravity(loads, dynamics):
    assert not loads.is_base_known(0.0)
    loads.set_base_motion(0.0, (1.0, 2.0, 9.0), (0.1, 0.2, 0.3))
    assert loads.update(0.0)
    other = InverseDynamics(load_urdf(STANFORD), DOWN)
    other.set_base_motion((0.1, 0.2, 0.3), linear_acceleration=np.array([1.0, 2.0, 9.0]) + DOWN)
    assert dynamics.gravity_efforts(Q) == pytest.approx(other.gravity_efforts(Q))
    assert loads.is_base_known(0.1)


def test_a_lost_imu_keeps_gravity_and_ends_the_rotation_of_the_base(loads, dynamics):
    loads.set_base_motion(0.0, (1.0, 2.0, 9.0), (0.1, 0.2, 0.3))
    assert loads.update(0.0)
    assert not loads.update(0.2)
    assert loads.update(0.3)
    assert not loads.update(0.4)
    other = InverseDynamics(load_urdf(STANFORD), (-1.0, -2.0, -9.0))
    assert dynamics.gravity_efforts(Q) == pytest.approx(other.gravity_efforts(Q))
    loads.set_base_motion(1.0, (0.0, 0.0, 9.8), (0.0, 0.0, 0.0))
    assert loads.update(1.0)


def test_the_motion_of_the_base_is_filtered(loads):
    loads.set_base_motion(0.0, (0.0, 0.0, 10.0), (0.5, 0.0, 0.0))
    loads.update(0.0)
    loads.set_base_motion(0.01, (0.0, 0.0, 11.0), (1.5, 0.0, 0.0))
    assert not loads.update(0.01)
    fraction = 1.0 - math.exp(-2.0 * math.pi * 20.0 * 0.01)
    assert loads.gravity[2] == pytest.approx(-10.0 - fraction)
    other = InverseDynamics(load_urdf(STANFORD), (0.0, 0.0, -10.0 - fraction))
    other.set_base_motion((0.5 + fraction, 0.0, 0.0))
    assert loads.dynamics.gravity_efforts(Q) == pytest.approx(other.gravity_efforts(Q))


def test_without_gravity_neither_it_nor_the_base_accelerates(loads, dynamics):
    loads.include(gravity=False)
    loads.set_gravity((0.0, 3.0, 0.0))
    loads.update(9.0)
    loads.update(19.0)
    assert not dynamics.gravity_efforts(Q).any()
    loads.include(gravity=True)
    assert dynamics.gravity == pytest.approx([0.0, 3.0, 0.0])


def test_vectors_are_in_the_frame_of_the_base_link():
    robot = load_urdf(
        '<robot name="r"><link name="world"/><link name="mount"/><link name="arm"><inertial>'
        '<origin xyz="0.5 0 0"/><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
        'ixz="0" iyz="0"/></inertial></link><joint name="tilt" type="fixed"><parent '
        'link="world"/><child link="mount"/><origin rpy="1.5707963267948966 0 0"/></joint>'
        '<joint name="j" type="continuous"><parent link="mount"/><child link="arm"/>'
        '<axis xyz="0 1 0"/></joint></robot>'
    )
    dynamics = InverseDynamics(robot)
    ExternalLoads(dynamics, gravity=(0.0, 0.0, -9.8), base_link='mount')
    assert dynamics.gravity == pytest.approx([0.0, 9.8, 0.0])
    assert dynamics.gravity_efforts([0.0])[0] == pytest.approx(-0.5 * 9.8)
    with pytest.raises(ConfigurationError, match=r"'arm', expected .*: world, mount"):
        ExternalLoads(dynamics, base_link='arm')


@pytest.mark.parametrize(
    ('call', 'words'),
    [
        (lambda x: x.set_payload('nope', 1.0, Q[:3], INERTIA), "link 'nope' does not exist"),
        (lambda x: x.set_external_wrench(0.0, '', DOWN, DOWN), "link '' does not exist; links"),
        (lambda x: x.set_external_wrench(0.0, TIP, [math.nan] * 3, DOWN), 'force is .*nan'),
        (lambda x: x.set_payload(TIP, 1e300, Q[:3], INERTIA), 'inertia. is 1e.300'),
        (lambda x: x.set_payload(TIP, 1.0, [1e200, 0, 0], INERTIA), 'inertia. is 1e.200'),
        (lambda x: x.set_payload(TIP, 1.0, Q[:3], 1e99 * INERTIA), 'inertia. is 2e.97'),
        (lambda x: x.set_payload(TIP, 1.0, Q[:3], FLAWED), 'moments .0.1, 0.1, 0.3 kg m'),
        (lambda x: x.set_gravity([1.0, 2.0]), 'expected three finite numbers'),
        (lambda x: x.set_gravity([101.0, 0.0, 0.0]), r'is \[101.0, 0.0, 0.0\], .* 100 m/s'),
        (lambda x: x.set_base_motion(0.0, [math.inf, 0, 0], DOWN), 'specific force is'),
        (lambda x: x.set_base_motion(0.0, [600.0, 0, 0], DOWN), 'specific force .*m/s.2'),
        (lambda x: x.set_base_motion(0.0, DOWN, [0, 0, 1e4]), 'at most 500 rad/s'),
        (lambda x: x.set_external_wrench(0.0, TIP, [2e9, 0, 0], DOWN), 'at most 1e.09 N along'),
        (lambda x: x.set_external_wrench(0.0, TIP, DOWN, [2e9, 0, 0]), '^moment .* 1e.09 N m'),
        (lambda x: ExternalLoads(x.dynamics, gravity=[math.nan] * 3), '^gravity is .*m/s.2'),
        (lambda x: x.set_payload(TIP, 1.0, Q[:3], SLENDER), 'exceeds the sum of the others'),
    ],
)
def test_rejects_impossible_loads(loads, dynamics, call, words):
    before = dynamics.table.copy()
    with pytest.raises(ConfigurationError, match=words):
        call(loads)
    loads.update(9.0)
    assert (dynamics.table == before).all()


WILD = st.sampled_from([0.0, -1e-300, 1e-20, 0.3, -1.0, 7.0, 1e9, -1e9, 1e150, 1.7e308])


@given(st.lists(st.tuples(WILD, *[WILD] * 9), min_size=1, max_size=4))
def test_accepted_loads_never_fail_later(messages):
    dynamics = InverseDynamics(load_urdf(STANFORD))
    loads = ExternalLoads(dynamics)
    now = 0.0
    for mass, *com, ixx, iyy, izz, ixy, ixz, iyz in messages:
        inertia = [[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]
        for call in (
            partial(loads.set_payload, TIP, mass, com, inertia),
            partial(loads.set_external_wrench, now, TIP, com, com[::-1]),
            partial(loads.set_base_motion, now, com, com[::-1]),
            partial(loads.set_gravity, com),
        ):
            with contextlib.suppress(ConfigurationError):
                call()
        for _ in range(4):
            now += 0.15
            loads.update(now)
            assert np.isfinite(dynamics.table).all()


@pytest.mark.parametrize('size', [1.0, 1e4])
def test_the_inertia_of_a_flat_body_may_be_rounded(loads, size):
    assert loads.set_payload(TIP, size, np.zeros(3), size * np.diag([1.0, 1.0, 2.0001]))
    with pytest.raises(ConfigurationError, match='exceeds the sum of the others'):
        loads.set_payload(TIP, size, np.zeros(3), size * np.diag([1.0, 1.0, 2.1]))


def test_the_largest_values_are_accepted(loads):
    assert loads.set_payload(TIP, 1e9, np.zeros(3), INERTIA)
    loads.set_external_wrench(0.0, TIP, (1e9, 0.0, 0.0), (0.0, -1e9, 0.0))
    loads.set_gravity((0.0, 100.0, 0.0))
    loads.set_base_motion(0.0, (0.0, 0.0, -500.0), (500.0, 0.0, 0.0))
    assert np.isfinite(loads.dynamics.gravity_efforts(Q)).all()


def test_without_an_imu_the_base_is_never_lost(dynamics):
    loads = ExternalLoads(dynamics)
    assert not any(loads.update(now) for now in (0.0, 0.1, 5.0))


@pytest.mark.parametrize(
    ('elapsed', 'may_jump'),
    [(0.0, False), (0.1, False), (0.99 * IMU_TIMEOUT, False), (0.3, True), (-99.0, True)],
)
def test_a_gap_in_the_imu_messages_is_a_loss_even_without_a_step(loads, elapsed, may_jump):
    loads.set_base_motion(100.0, (0.0, 0.0, 10.0), np.zeros(3))
    loads.update(100.0)
    loads.set_base_motion(100.0 + elapsed, (1.0, 0.0, 11.0), np.zeros(3))
    assert loads.update(100.0 + elapsed) is may_jump
    if may_jump:  # the filter restarts
        assert loads.gravity == pytest.approx([-1.0, 0.0, -11.0])


def test_a_wrench_acts_until_its_time_out(dynamics):
    loads = ExternalLoads(dynamics, Settings(wrench_timeout=0.125))
    before = dynamics.gravity_efforts(Q)
    loads.set_external_wrench(0.0, TIP, (1.0, 2.0, 3.0), (0.1, 0.2, 0.3))
    whole = dynamics.gravity_efforts(Q) - before
    for now in (0.0, 0.1, 0.125):
        loads.update(now)
        assert dynamics.gravity_efforts(Q) - before == pytest.approx(whole)
    loads.update(0.13)
    assert dynamics.gravity_efforts(Q) == pytest.approx(before)
