"""Pictures of robots with many joints and branches: legible, complete, nothing overlaps."""

from inverse_dynamics_node.analysis.recordings.signals import Recording
from inverse_dynamics_node.cli.main import main
from inverse_dynamics_node.cli.pictures import style
from inverse_dynamics_node.dynamics.inverse_dynamics import InverseDynamics
from inverse_dynamics_node.robot.urdf import load_urdf
from large_robots import three_finger_hand, two_arms
import numpy as np
import pytest
from robot_files import STANFORD
from runs import exciting
from simulated_runs import write_csv

ROBOTS = {
    'stanford': STANFORD.read_text,
    'two_arms': two_arms,
    'three_finger_hand': three_finger_hand,
}


@pytest.fixture
def drawn(monkeypatch):
    """Return the figures that would be saved."""
    figures = []

    def save(figure, path):
        figure.set_dpi(100)
        path.touch()
        figures.append(figure)

    monkeypatch.setattr('matplotlib.figure.Figure.savefig', save)
    return figures


LEFT_OUT = ('two_arms', 'three_finger_hand')


@pytest.fixture(
    params=['stanford', *(pytest.param(name, marks=pytest.mark.long) for name in LEFT_OUT)]
)
def robot(request, here):
    (here / 'arm.urdf').write_text(ROBOTS[request.param]())
    return load_urdf(here / 'arm.urdf')


def write_run(robot, path):
    """Record a motion of all joints, with some friction."""
    times = 0.01 * np.arange(400)
    q, qd, qdd = exciting(robot, times, np.random.default_rng(1))
    efforts = InverseDynamics(robot).efforts(q, qd, qdd)
    efforts += 0.05 * np.tanh(qd / 0.01) * np.mean(np.abs(efforts), axis=0)
    write_csv(path, Recording(robot.joint_names, times, q, qd, efforts))


def texts_of(figure):
    """Return the visible texts of a figure, without the numbers on axes, and their boxes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    ticks = {label for axes in figure.axes for label in axes.get_xticklabels()}
    ticks |= {
        label
        for axes in figure.axes
        for label in axes.get_yticklabels()
        if label.get_text().strip('0123456789.−-') == ''
    }
    found = [
        text
        for text in figure.findobj(Text)
        if text.get_visible() and text.get_text().strip() and text not in ticks
    ]
    return [(text.get_text(), text.get_window_extent(renderer)) for text in found]


def assert_legible(figure):
    boxes = texts_of(figure)
    for k, (text, box) in enumerate(boxes):
        assert box.x0 >= -1.0, text
        assert box.x1 <= figure.bbox.width + 1.0, text
        for other, place in boxes[k + 1 :]:
            assert not box.padded(-1.0).overlaps(place.padded(-1.0)), (text, other)


def test_effort_names_joints_file_and_payload(robot, drawn, here):
    write_run(robot, here / 'move.csv')
    arguments = ['effort', 'arm.urdf', 'move.csv', '--payload', '0.25']
    assert main(arguments) == 0
    (figure,) = drawn
    assert_legible(figure)
    first, second = figure._suptitle.get_text().splitlines()
    assert first == f'{robot.name}: efforts along move.csv'
    assert second.startswith("payload 0.25 kg on link '")
    panels = [axes for axes in figure.axes if axes.get_visible()]
    names = [axes.get_title(loc='left').splitlines()[0] for axes in panels]
    assert names == list(robot.joint_names)
    peaks = [axes.get_title(loc='left').splitlines()[1] for axes in panels]
    for text, limit in zip(peaks, robot.effort_limits, strict=True):
        assert ('no limit' in text) == np.isinf(limit)


def test_compare_names_joints_and_recording(robot, drawn, here):
    write_run(robot, here / 'run.csv')
    assert main(['compare', 'arm.urdf', 'run.csv', '--payload', '0.01']) in (0, 3)
    (figure,) = drawn
    assert_legible(figure)
    first = figure._suptitle.get_text().splitlines()[0]
    assert first.startswith(f'{robot.name}: run.csv, payload 0.01 kg on link ')
    titles = [axes.get_title(loc='left') for axes in figure.axes]
    names = [title.partition(' [')[0] for title in titles if title]
    assert len(set(names) - {'measured minus modelled'}) == len(robot.joint_names)


def test_shortened_names_are_distinct():
    assert style.elided('gripper_left_finger_1', 15) == 'gripper…inger_1'
    assert style.elided('elbow', 15) == 'elbow'
    assert style.all_elided(['left_arm_elbow', 'right_arm_wrist'], 9) == [
        'left…lbow',
        'righ…rist',
    ]
    names = ['scara_inner_arm_joint', 'scara_outer_arm_joint']
    assert style.all_elided(names, 9) == names
