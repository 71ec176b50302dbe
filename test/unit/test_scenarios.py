"""The scenarios of the demo: loads and pushes, verdicts, the live view and pictures."""

from dataclasses import replace
import io
import math
from types import SimpleNamespace

from large_robots import two_arms
from matplotlib.figure import Figure
import numpy as np
import pytest
from robot_files import OUR_ROBOTS, real_robots, ROOT, STANFORD

pytest.importorskip('rclpy')
pytest.importorskip('mujoco')

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.cli.pictures.demo import draw
from inverse_dynamics_node.simulation.demo import results
from inverse_dynamics_node.simulation.demo.commander import History, resolved_acceleration
from inverse_dynamics_node.simulation.demo.demo import describe_rotors
from inverse_dynamics_node.simulation.demo.demo_setup import (
    DEFLECTION,
    DemoSetup,
    GRIP,
    KP,
)
from inverse_dynamics_node.simulation.demo.results import (
    check_tracking,
    judge_tracking,
    RATE_LIMIT,
    tracking_limits,
)
from inverse_dynamics_node.simulation.demo.scenarios import (
    held_without_imu,
    SCENARIOS,
    Timeline,
)
from inverse_dynamics_node.simulation.demo.view import (
    bar,
    error_fraction,
    Snapshot,
    View,
)
from inverse_dynamics_node.simulation.mujoco.hardware import MujocoRobot
from inverse_dynamics_node.simulation.mujoco.model import SimulationError
from inverse_dynamics_node.simulation.trajectory import EFFORT_USED, effort_used, start_pose
from rich.console import Console
from simulated_runs import with_friction

GRIPPER_ARM = ROOT / 'test' / 'robots' / 'gripper_arm.urdf'


def stage_of(path, duration=10.0, link=''):
    robot = load_urdf(path)
    return DemoSetup(str(path), robot, start_pose(robot, InverseDynamics(robot)), duration, link)


@pytest.fixture(scope='module')
def setup():
    return stage_of(STANFORD)


@pytest.fixture(params=OUR_ROBOTS, ids=lambda path: path.stem)
def any_stage(request):
    return stage_of(request.param)


def history_of(setup, *phases):
    """Return a history from phases of (end, error of the first joint)."""
    history = History()
    ends, errors = zip(*phases, strict=True)
    for time in np.arange(0.0, setup.duration, 0.01):
        q = setup.start.copy()
        q[0] += errors[int(np.searchsorted(ends, time, side='right'))]
        history.states.add(time, (q, setup.start, np.ones(len(q))))
        history.commands.add(time, np.ones(len(q)))
        history.external.add(time, np.zeros(len(q)))
    return history


class TestStage:
    @pytest.mark.parametrize(
        ('robot', 'link'), [('stanford', 'tool0'), ('seven_dof', 'tool0'), ('gripper_arm', 'palm')]
    )
    def test_loads_and_pushes_are_put_on_the_hand(self, robot, link):
        (path,) = (path for path in OUR_ROBOTS if path.stem == robot)
        setup = stage_of(path)
        assert setup.load()[0] == link
        assert setup.push()[0] == link

    @pytest.mark.parametrize('robot', ['z1', 'tiago_no_hand', 'kinova', 'pr2', 'a1'])
    def test_loads_of_real_robots_have_at_least_a_hundredth_of_their_mass(self, robot):
        path = next((path for path in real_robots() if path.stem == robot), None)
        if path is None:
            pytest.skip('example-robot-data is not installed')
        setup = stage_of(path)
        link, mass, _ = setup.load()
        assert 0.01 * setup.robot.mass.sum() <= mass < setup.capacity(link)
        body = setup.robot.link_body[setup.robot.link_names.index(link)]
        assert body > 0  # not the base
        assert 'finger' not in link
        assert 'gripper' not in setup.robot.body_names[body].lower()

    def test_capacity_is_the_load_that_takes_a_drive_to_its_limit(self, setup):
        link, _, _ = setup.load()
        dynamics = InverseDynamics(setup.robot)
        dynamics.set_payload(link, setup.capacity(link), GRIP)
        assert effort_used(setup.robot, dynamics.gravity_efforts(setup.start)) == pytest.approx(1)

    def test_script_names_load_link_and_capacity(self, setup):
        link, mass, _ = setup.load()
        timeline = SCENARIOS['payload'].prepare(setup)
        capacity = f'{setup.capacity(link):.2g}'
        expected = f"load: {mass:g} kg at '{link}', where the drives could hold {capacity} kg"
        assert timeline.note == expected
        assert f"{mass:g} kg at '{link}'" in timeline.events[0].words

    def test_joints_that_move_no_mass_are_rejected_by_name(self):
        text = (
            '<robot name="massless"><link name="base"/><link name="tip"/>'
            '<joint name="idle" type="continuous"><parent link="base"/><child link="tip"/></joint>'
            '</robot>'
        )
        robot = load_urdf(text)
        with pytest.raises(SimulationError, match="no mass resists the motion of joint 'idle'"):
            DemoSetup('', robot, np.zeros(1), 10.0).load()

    def test_robot_withstands_its_loads_and_pushes(self, any_stage):
        robot, start = any_stage.robot, any_stage.start
        alone = InverseDynamics(robot)
        link, mass, inertia = any_stage.load()
        assert 0.0 < mass <= 5.0
        loaded, pushed = InverseDynamics(robot), InverseDynamics(robot)
        loaded.set_payload(link, mass, (0.0, 0.0, 0.05), inertia)
        link, force = any_stage.push()
        assert np.linalg.norm(force) > 0.0
        pushed.set_external_wrench(link, force)
        for dynamics in loaded, pushed:
            efforts = dynamics.gravity_efforts(start)
            used = effort_used(robot, efforts)
            assert used <= max(EFFORT_USED, effort_used(robot, alone.gravity_efforts(start)))
            difference = efforts - alone.gravity_efforts(start)
            error = np.linalg.solve(alone.mass_matrix(start), difference) / KP
            assert abs(error).max() <= 1.06 * DEFLECTION  # rounded to two digits

    def test_loads_and_pushes_change_the_efforts(self, setup):
        link, mass, _ = setup.load()
        dynamics = InverseDynamics(setup.robot)
        alone = dynamics.gravity_efforts(setup.start)
        dynamics.set_payload(link, mass)
        assert abs(dynamics.gravity_efforts(setup.start) - alone).max() > 0.5
        assert abs(setup.external_efforts(*setup.push(), setup.start)).max() > 1.0


class TestScripts:
    @pytest.mark.parametrize('name', SCENARIOS)
    def test_events_are_in_order_and_within_the_run(self, setup, name):
        timeline = SCENARIOS[name].prepare(setup)
        times = [event.time for event in timeline.events]
        assert times == sorted(times)
        assert all(0.0 < time < setup.duration for time in times)
        for time in 0.0, 0.5 * setup.duration:
            assert np.isfinite(timeline.trajectory.sample(time)).all()

    def test_external_efforts_are_expected_during_the_push_only(self, setup):
        timeline = SCENARIOS['push'].prepare(setup)
        began, ended = (event.time for event in timeline.events)
        times = np.array([began - 0.1, began + 0.1, ended - 0.1, ended + 0.1])
        efforts = timeline.expected(times, np.tile(setup.start, (4, 1)))
        assert (abs(efforts).max(axis=1) > 1.0).tolist() == [False, True, True, False]

    def test_arm_sags_on_a_tilted_base_without_an_imu(self, setup):
        times, errors = held_without_imu(setup, 2.5)
        assert abs(errors[times < 2.5]).max() < 1e-6
        assert abs(errors[times > 7.0]).max() > 0.01


def two_joints(slack=(0.0, 0.0)):
    """Return the part of a set-up with which tracking is judged."""
    robot = SimpleNamespace(joint_names=('a', 'b'))
    return SimpleNamespace(robot=robot, rate=500.0, slack=np.array(slack))


class TestResults:
    def test_tracking_within_the_limits_has_no_failures(self):
        small = np.full(2, 1e-4)
        assert judge_tracking(two_joints(), small, small, 499.0).failures == ()

    @pytest.mark.parametrize(
        ('moving', 'rest', 'rate', 'words'),
        [
            (0.011, 0.0, 500.0, "joint 'a' was 11.00 mrad or mm off while moving"),
            (0.0, 0.0011, 500.0, "joint 'a' was 1.10 mrad or mm off at rest"),
            (0.0, math.nan, 500.0, 'off at rest'),
            (0.0, 0.0, 489.0, '489.0 commands/s received, expected 500.0 +- 2%: this machine is'),
            (0.0, 0.0, 511.0, '511.0 commands/s received, expected 500.0 +- 2%: another node'),
            (0.0, 0.0, math.nan, 'nan commands/s received'),
        ],
    )
    def test_each_limit_exceeded_in_tracking_is_reported(self, moving, rest, rate, words):
        errors = np.array([moving, 0.0]), np.array([rest, 0.0])
        (failure,) = judge_tracking(two_joints(), *errors, rate).failures
        assert words in failure

    @pytest.mark.parametrize('duration', [3.0, 15.0])
    @pytest.mark.parametrize(
        ('stalled', 'resumed'), [(0.0, 0.0), (-0.13, 0.0), (-0.13, 0.05), (0.7, 0.83), (2.8, 2.93)]
    )
    def test_commands_that_queued_up_do_not_raise_the_rate(self, stalled, resumed, duration):
        history = History()
        due = np.arange(max(stalled, -0.13) if stalled < 0.0 else 0.0, duration, 0.002)
        waited = (due >= stalled) & (due < resumed)
        history.arrivals = np.where(waited, resumed, due).tolist()
        assert history.command_rate() == pytest.approx(500.0, rel=0.5 * RATE_LIMIT)

    def test_commands_that_are_missing_lower_the_rate(self):
        history = History()
        times = np.arange(0.0, 10.0, 0.002)
        history.arrivals = times[np.arange(len(times)) % 20 != 0].tolist()
        assert history.command_rate() == pytest.approx(475.0, rel=1e-3)
        assert history.command_rate(9.0) == pytest.approx(475.0, rel=5e-3)
        assert history.command_rate(10.0) == 0.0
        history.arrivals = [1.0, 1.0, 1.0]
        assert history.command_rate() == 0.0

    def test_largest_error_ignores_other_times(self, setup):
        history = history_of(setup, (2.0, 0.1), (4.0, -0.2), (99.0, 0.3))
        assert history.largest_error(2.5, 3.5) == pytest.approx([0.2, 0, 0, 0, 0, 0])
        assert np.isnan(history.largest_error(20.0, 30.0)).all()

    @pytest.mark.parametrize(
        ('errors', 'words'),
        [
            ((0.001, 0.2, 0.001), ''),
            ((0.02, 0.2, 0.001), 'a joint was off by 20 mrad before'),
            ((0.001, 0.2, 0.02), 'a joint was off by 20 mrad although'),
            ((0.001, 0.001, 0.001), '1.0 times better'),
        ],
    )
    def test_load(self, setup, errors, words):
        history = history_of(setup, (3.0, errors[0]), (6.1, errors[1]), (99.0, errors[2]))
        outcome = results.check_payload(setup, history, 3.0, 6.0)
        assert words in str(outcome)
        assert len(outcome.failures) == bool(words)
        assert str(outcome).startswith('FAILED' if words else 'PASSED')

    @pytest.mark.parametrize(
        ('scale', 'words'),
        [(1.0, ''), (1.04, ''), (1.1, 'are 10.0% off'), (-1.0, 'are 200.0% off'), (0, '100')],
    )
    def test_push(self, setup, scale, words):
        link, force = setup.push()
        history = history_of(setup, (99.0, 0.0))
        history.external = type(history.external)()
        expected = setup.external_efforts(link, force, setup.start)
        for time in history.states.times:
            history.external.add(time, scale * expected * (3.0 <= time < 6.0))
        outcome = results.check_push(setup, history, link, force, 3.0, 6.0)
        assert words in str(outcome)
        assert len(outcome.failures) == bool(words)

    def test_push_without_external_efforts_fails(self, setup):
        history = history_of(setup, (99.0, 0.0))
        history.external = type(history.external)()
        outcome = results.check_push(setup, history, *setup.push(), 3.0, 6.0)
        assert 'published no external efforts' in str(outcome)

    @pytest.mark.parametrize(
        ('errors', 'count'), [((0.005, 0.0001), 0), ((0.02, 0.0001), 1), ((0.005, 0.002), 1)]
    )
    def test_tilt(self, setup, errors, count):
        history = history_of(setup, (7.0, errors[0]), (99.0, errors[1]))
        without = np.arange(2.0), np.outer([0.0, 0.2], np.ones(6))
        outcome = results.check_tilt(setup, history, 7.0, without)
        assert len(outcome.failures) == count

    @pytest.mark.parametrize(
        ('zero_from', 'brakes', 'count'),
        [(3.5, [1, 0], 0), (4.5, [1, 0], 1), (3.5, [], 1), (3.5, [1], 1)],
    )
    def test_sensor_lost(self, setup, zero_from, brakes, count):
        history = history_of(setup, (99.0, 0.0))
        history.commands = type(history.commands)()
        for time in np.arange(0.0, 10.0, 0.01):
            history.commands.add(time, np.full(6, 0.0 if zero_from <= time < 5.0 else 1.0))
        for i, on in enumerate(brakes):
            history.brakes.add(3.0 + 3.0 * i, on)
        assert len(results.check_sensor_lost(setup, history, 3.0, 5.0).failures) == count


class TestView:
    def snapshot(self, setup, words='the arm stands still', off=0.001):
        start = setup.start
        return Snapshot(1.2, 500.0, words, start + off, start, start, brakes_on=True)

    def terminal(self):
        return Console(file=io.StringIO(), force_terminal=True, width=100, height=40)

    def test_terminal_shows_every_joint_and_the_current_event(self, setup, monkeypatch):
        monkeypatch.setattr('inverse_dynamics_node.simulation.demo.view.LIVE_PERIOD', 3600.0)
        console = self.terminal()
        view = View(setup.robot, 'stanford: push', console)
        with view.open():
            assert view.is_live
            assert view.is_due
            view.draw(self.snapshot(setup, 'a push of 5 N'))
            assert not view.is_due
        text = console.file.getvalue()
        for words in (*setup.robot.joint_names, 'stanford: push', 'a push of 5 N', 'BRAKES ON'):
            assert words in text
        assert '█' in text

    def test_nothing_is_drawn_in_a_pipe(self, setup):
        console = Console(file=io.StringIO())
        view = View(setup.robot, 'stanford: push', console)
        with view.open():
            assert not view.is_live
            assert not view.is_due
        assert console.file.getvalue() == ''

    def test_lines_have_units(self, setup, capsys):
        View(setup.robot, '', Console(file=io.StringIO())).print_progress(self.snapshot(setup))
        lines = capsys.readouterr().out.splitlines()
        assert lines[1] == 't = 1.2 s   500.0 commands/s'
        assert 'mrad' in lines[3]
        assert ' mm ' in lines[5]

    def test_columns_of_large_errors_are_separate(self, setup, capsys):
        view = View(setup.robot, '', Console(file=io.StringIO()))
        view.print_progress(self.snapshot(setup, off=-2.0))
        assert ' 2000.000 mrad' in capsys.readouterr().out

    def test_units_are_aligned(self, setup):
        console = Console(file=io.StringIO(), width=110)
        console.print(View(setup.robot, '').render(self.snapshot(setup)))
        rows = [line for line in console.file.getvalue().splitlines() if 'joint_' in line]
        assert len({row.index('m' if 'N  ' in row else 'rad') for row in rows}) == 1

    def test_columns_are_aligned_with_long_names(self, setup, capsys):
        names = tuple(f'the_{name}_of_the_robot_on_the_left' for name in setup.robot.joint_names)
        robot = replace(
            setup.robot, joint_names=names, body_names=(setup.robot.body_names[0], *names)
        )
        View(robot, '', Console(file=io.StringIO())).print_progress(self.snapshot(setup))
        head, *rows = capsys.readouterr().out.splitlines()[2:]
        assert {len(row) for row in rows} == {len(head)}

    @pytest.mark.parametrize(('error', 'fraction'), [(0.1, 1.0), (-0.01, 0.75), (1e-5, 0.0)])
    def test_error_bar_is_logarithmic(self, error, fraction):
        assert error_fraction(error) == pytest.approx(fraction)

    @pytest.mark.parametrize(
        ('fraction', 'text', 'colour'),
        [(0.0, '·' * 12, 'green'), (0.8, '█' * 10 + '·' * 2, 'yellow'), (9.0, '█' * 12, 'red')],
    )
    def test_bar_fills_and_changes_its_colour(self, fraction, text, colour):
        drawn = bar(fraction, 0.7, 0.9)
        assert drawn.plain == text
        assert str(drawn.spans[0].style if drawn.spans else colour) in (colour, 'bright_black')


class TestFriction:
    @pytest.fixture
    def rubbing(self, tmp_path):
        """Return a robot with friction in every joint and hardly any inertia in its wrist."""
        path = tmp_path / 'rubbing.urdf'
        names = load_urdf(STANFORD).joint_names
        path.write_text(with_friction(STANFORD, [0.1] * len(names), [1.0] * len(names)))
        robot = load_urdf(path)
        start = start_pose(robot, InverseDynamics(robot))
        return DemoSetup(str(path), robot, start, 10.0, friction=True)

    def test_joints_with_friction_and_hardly_any_inertia_get_rotors(self, rubbing):
        assert rubbing.armature[0] == 0.0
        assert rubbing.armature[5] == pytest.approx(0.1 - rubbing.inertia[5])
        words = ' '.join(describe_rotors(rubbing).split())
        assert 'joint_1' not in words
        assert 'joint_6 0.1 kg m^2' in words
        assert not np.any(replace(rubbing, friction=False).armature)

    def test_friction_widens_errors_by_the_slack_at_most(self, rubbing):
        real = MujocoRobot(rubbing.urdf, rubbing.robot, rubbing.start, armature=rubbing.armature)
        real.brakes_on = False
        order = [real.state_names.index(name) for name in rubbing.robot.joint_names]
        trajectory = SCENARIOS['track'].prepare(rubbing).trajectory
        times = np.arange(0.0, 10.0, 0.002)
        errors, late = np.zeros((len(times), len(order))), []
        model = rubbing.dynamics()
        for error, *reference in zip(errors, *trajectory.sample(times), strict=True):
            q, qd = (values[order] for values in real.state()[:2])
            error[:] = reference[0] - q
            late.append(model.efforts(q, qd, resolved_acceleration(reference, q, qd)))
            real.command(late[max(0, len(late) - 3)])
            real.advance(0.002)
        assert np.all(np.max(np.abs(errors), axis=0) < results.MOVING_LIMIT + rubbing.slack)
        assert np.all(np.abs(errors[-1]) < results.REST_LIMIT + rubbing.slack)
        assert np.max(rubbing.slack) < 0.05

    @pytest.mark.parametrize('beyond', [False, True])
    def test_table_and_verdict_have_the_same_limits(self, rubbing, beyond, capsys):
        moving, rest = (1000.0 * limits for limits in tracking_limits(rubbing.slack))
        history = History()
        for time in np.arange(0.0, rubbing.duration, 0.002):
            q = rubbing.start.copy()
            q[4] += (1.01 if beyond else 0.99) * 1e-3 * (moving[4] if time < 5.0 else rest[4])
            history.states.add(time, (q, rubbing.start, q))
            history.arrivals.append(time)
        outcome = str(check_tracking(rubbing, history))
        row = next(r for r in capsys.readouterr().out.splitlines() if r.startswith('joint_5'))
        numbers = [float(word) for word in row.split()[1:] if word != 'mrad']
        assert numbers[1::2] == pytest.approx([moving[4], rest[4]], abs=1e-3)
        assert numbers[0::2] == pytest.approx(
            np.array(numbers[1::2]) * (1.01 if beyond else 0.99), abs=2e-3
        )
        if beyond:
            assert f'mrad or mm off while moving, limit {moving[4]:.3g}' in outcome
            assert f'mrad or mm off at rest, limit {rest[4]:.3g}' in outcome
        else:
            assert outcome.startswith('PASSED')
            assert f'{moving.min():.3g} to {moving.max():.3g} mrad (mm) while moving' in outcome
            assert f'{rest.min():.3g} to {rest.max():.3g} mrad (mm) at rest' in outcome

    def test_slack_widens_the_limits_of_its_joint_alone(self):
        moving, rest = np.array([0.03, 0.03]), np.array([0.0, 0.0])
        (failure,) = judge_tracking(two_joints((0.03, 0.0)), moving, rest, 500.0).failures
        assert "'b' was 30.00" in failure


def test_a_failure_on_a_busy_machine_says_so():
    history = History()
    for time in (0.0, 0.002, 0.004):
        history.commands.add(time, np.ones(1))
    assert results.excuse(history) == ''
    history.commands.add(0.404, np.ones(1))
    words = results.excuse(history)
    assert 'no command came for 400 ms' in words
    assert str(results.ScenarioResult('all', ('too far',), words)) == f'FAILED: too far\n{words}'
    assert str(results.ScenarioResult('all', (), words)) == 'PASSED: all'


@pytest.mark.parametrize(
    'name',
    [
        pytest.param(name, marks=[] if name in ('tilt', 'track') else pytest.mark.long)
        for name in SCENARIOS
    ],
)
def test_picture_is_drawn(tmp_path, name, setup):
    timeline = SCENARIOS[name].prepare(setup)
    history = history_of(setup, (3.0, 0.01), (6.0, 0.1), (99.0, 0.0))
    picture = tmp_path / 'run.png'
    draw(setup.robot, name, timeline, history, picture)
    header = picture.read_bytes()[:24]
    assert header[1:4] == b'PNG'
    assert int.from_bytes(header[16:20], 'big') == 900


@pytest.mark.parametrize('name', SCENARIOS)
def test_captions_of_events_with_long_names_fit(tmp_path, name, monkeypatch, setup):
    timeline = SCENARIOS[name].prepare(setup)
    mount = 'at left_arm_gripper_mount_link'
    events = tuple(replace(event, words=f'{event.words} {mount}') for event in timeline.events)
    timeline = replace(timeline, events=events)
    figures = []
    monkeypatch.setattr(Figure, 'savefig', lambda figure, path: figures.append(figure))
    draw(setup.robot, name, timeline, history_of(setup, (99.0, 0.0)), tmp_path / 'a.png')
    (figure,) = figures
    figure.canvas.draw()
    for text in figure.axes[0].texts:
        box = text.get_window_extent()
        assert box.x0 >= 0.0
        assert box.x1 <= figure.bbox.width


def test_many_joints_without_limits_are_distinguishable(tmp_path, monkeypatch):
    robot = load_urdf(two_arms())
    n = len(robot.joint_names)
    history = History()
    for time in np.linspace(0.0, 8.0, 50):
        history.states.add(time, np.zeros((3, n)))
        history.commands.add(time, 0.01 * (1.0 + np.arange(n)) * np.sin(time))
    figures = []
    monkeypatch.setattr(Figure, 'savefig', lambda figure, path: figures.append(figure))
    title = 'PASSED: ' + 'largest error 1.5e-05 rad, ' * 12
    draw(robot, title, Timeline(None, None), history, tmp_path / 'a.png')
    (figure,) = figures
    errors, efforts = figure.axes
    for axes in (errors, efforts):
        looks = [(line.get_color(), line._dash_pattern) for line in axes.lines[:n]]
        assert len(set(map(str, looks))) == n
    labels = [label.get_text() for label in efforts.get_yticklabels()]
    for label, name, limit in zip(labels, robot.joint_names, robot.effort_limits, strict=True):
        assert label.startswith(f'{name}: ')
        assert ('no limit' in label) == np.isinf(limit)
        assert '100 %' not in label
    # Each row has its own scale, also if the joint uses a small part of its limit.
    heights = [np.ptp(line.get_ydata()) for line in efforts.lines[:n]]
    is_used = robot.effort_limits * 1e-3 < 0.01 * (1.0 + np.arange(n))
    assert np.all(np.array(heights)[is_used] > 0.4)
    assert figure._suptitle.get_text().split() == title.split()


@pytest.mark.parametrize('path', OUR_ROBOTS, ids=lambda path: path.stem)
def test_legend_with_long_names_fits(tmp_path, path, monkeypatch):
    setup = stage_of(path)
    joints, bodies = (
        tuple(f'left_arm_{name}_of_it' for name in names)
        for names in (setup.robot.joint_names, setup.robot.body_names)
    )
    robot = replace(setup.robot, joint_names=joints, body_names=bodies)
    figures = []
    monkeypatch.setattr(Figure, 'savefig', lambda figure, path: figures.append(figure))
    timeline = SCENARIOS['hold'].prepare(setup)
    draw(
        robot,
        'FAILED: too far\n' * 20,
        timeline,
        history_of(setup, (99.0, 0.0)),
        tmp_path / 'a.png',
    )
    (figure,) = figures
    figure.canvas.draw()
    box = figure.legends[0].get_window_extent()
    assert box.x0 >= 0.0
    assert box.x1 <= figure.bbox.width
    assert figure._suptitle.get_text().count('\n') == 5
