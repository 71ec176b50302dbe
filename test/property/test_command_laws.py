"""Laws that every command obeys, whatever happens between two steps."""

from itertools import chain
import math

from hypothesis import given, settings
from hypothesis import strategies as st
from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.control.loop import COMPUTING_PHASES, ControlLoop, Phase
from inverse_dynamics_node.control.settings import Mode, Settings, StalePolicy
import numpy as np
import pytest
from states import Arm, PLANAR, Q, reference, store_state, unobserved

LINK = PLANAR.link_names[-1]
QD = np.array([0.3, 0.2])
LARGEST = 100.0  # [N m]; more than any effort computed here
ROUNDING = 1e-9  # [N m]
SHORTEST = 0.2  # [s]; of the start ramps that are not zero
PERIOD = 0.05  # [s]; ramps advance by at most as long in one command

efforts = st.sampled_from([0.5, 3.0, 20.0])
some_settings = st.fixed_dictionaries(
    {
        'mode': st.sampled_from([Mode.INVERSE_DYNAMICS, Mode.GRAVITY_COMPENSATION]),
        'on_stale_state': st.sampled_from(StalePolicy),
        'start_ramp': st.sampled_from([SHORTEST, 1.0]),
        'stop_ramp': st.sampled_from([0.0, 0.1, 0.5]),
        'effort_scale': st.sampled_from([-1.0, 0.5, 1.0]),
        'use_urdf_effort_limits': st.booleans(),
        'effort_limits': st.one_of(st.just(LARGEST), efforts, st.tuples(efforts, efforts)),
        'effort_rate_limits': st.sampled_from([math.inf, 1.0, 20.0, (5.0, math.inf)]),
    }
)
times = st.one_of(
    st.floats(0.0, 0.05), st.sampled_from([0.01, 0.01, 0.01, 0.1, 1.0, 50.0, -1.0, -100.0])
)
inputs = st.sampled_from(['fresh', 'fresh', 'fresh', 'lost', 'none', 'absurd'])
events = st.one_of(
    st.sampled_from(['stop', 'resume', 'start', 'again', 'heavier']),
    some_settings,
)
steps = st.tuples(times, inputs)
tuning = st.lists(steps, max_size=12).map(lambda some: [('again', [step]) for step in some])
acts = st.tuples(events, st.lists(steps, max_size=12)).map(lambda act: [act])
scenes = st.lists(st.one_of(acts, acts, tuning), max_size=12).map(lambda some: [*chain(*some)])


class Watched:
    """Checks every command of a controller against the laws."""

    def __init__(self, first, accelerations):
        self.arm = Arm(is_observed=False, settings=Settings(**first), period=PERIOD)
        self.has_started = False
        self.accelerations, self.added = accelerations, np.array(accelerations)[::-1] / 10.0
        self.now, self.last = 100.0, np.zeros(2)
        self.bound = np.zeros(2)  # the last command before the latest change
        self.has_changed = self.changed_before = self.was_falling = False
        self.has_event = False
        self.fallen = self.settling = 0.0

    def happen(self, event):
        ours = self.arm.loop
        self.has_changed = event not in ('stop', 'resume')
        self.has_event = True
        if self.has_changed:
            self.bound = np.abs(self.last)
        if event == 'stop':
            ours.stop()
        elif event == 'resume':
            ours.resume()
        elif event == 'start':
            ours.start()
            self.last, self.was_falling, self.has_started = np.zeros(2), False, False
        elif event == 'again':
            ours.apply(ours.settings)
        elif event == 'heavier':
            ours.loads.set_payload(LINK, 0.5, np.zeros(3), np.zeros((3, 3)))
        else:
            ours.apply(Settings(**event))

    def step(self, elapsed, given_input='fresh'):
        """Advance the time, and check the next command."""
        given = elapsed
        self.now += elapsed
        received = {'lost': self.now - 10.0, 'none': math.nan}.get(given_input, self.now)
        wanted = [1e308, 1e308] if given_input == 'absurd' else self.accelerations
        followed = reference(self.now, None, None, wanted, self.added)
        ours, efforts = self.arm.loop, self.arm.at(self.now, Q, QD, followed, received)
        if efforts is None:
            assert ours.phase is Phase.WAITING
            return
        assert np.isfinite(efforts).all()
        late = max(0.0, elapsed)
        expected = min(late, PERIOD) if self.has_started else 0.0
        assert ours.shaper.clock.step == pytest.approx(expected)
        self.has_started = True
        elapsed = ours.shaper.clock.step
        if ours.phase in COMPUTING_PHASES:
            self.check_followed(efforts, elapsed)
            self.was_falling = False
        elif ours.phase is Phase.STOPPED or ours.settings.on_stale_state is StalePolicy.ZERO:
            self.check_fall(efforts, elapsed)
        else:
            self.was_falling = False
            assert (np.abs(efforts) <= np.abs(self.last)).all()
            assert (efforts * self.last >= 0.0).all()
        self.check_limits(efforts)
        # If something changes at two steps in a row, the blend advances with the second one.
        if not 0.0 <= given <= 4.0 * PERIOD:
            self.settling = 0.2 + late
        self.changed_before = self.has_event or self.settling > 0.0
        self.settling = max(0.0, self.settling - late)
        self.last, self.has_changed, self.has_event = efforts, False, False

    def check_followed(self, efforts, elapsed):
        change = np.abs(efforts - self.last)
        ours = self.arm.loop.settings
        rates = np.array(ours.effort_rate_limits)
        limits = np.where(np.isinf(rates), math.inf, np.minimum(rates, 1e9) * elapsed)
        assert (change <= limits + ROUNDING).all()
        if ours.start_ramp:
            # The state and the reference stay the same: only ramps and blends move the efforts.
            is_first = self.has_changed and not self.changed_before
            fraction = 0.0 if is_first else elapsed / SHORTEST
            # After a brief fall, a limit that cut the efforts before it may cut them later.
            fallen = min(1.0, self.fallen / self.ramp) if self.was_falling and self.ramp else 0.0
            assert (change <= LARGEST * (3.0 * fraction + fallen) + ROUNDING).all()

    def check_fall(self, efforts, elapsed):
        ramp = self.arm.loop.settings.stop_ramp
        if self.was_falling:
            ramp = self.ramp
            self.fallen += elapsed
        else:
            self.was_falling, self.fallen, self.ramp, self.top = True, 0.0, ramp, self.last
        assert (np.abs(efforts) <= np.abs(self.last)).all()
        assert (efforts * self.last >= 0.0).all()
        fraction = max(0.0, 1.0 - self.fallen / ramp) if ramp else 0.0
        assert np.allclose(efforts, fraction * self.top, rtol=0.0, atol=ROUNDING)
        if self.fallen > ramp + ROUNDING:
            assert efforts.tolist() == [0.0, 0.0]
        if fraction == 1.0:
            assert (efforts == self.last).all()

    def check_limits(self, efforts):
        # Below the bound of a limit that was tightened, an effort may rise with the start ramp.
        limits = np.maximum(self.arm.loop.limits, self.bound)
        assert (np.abs(efforts) <= limits + ROUNDING).all()


def play(first, accelerations, acts):
    watched = Watched(first, accelerations)
    for event, steps in acts:
        watched.happen(event)
        for elapsed, given_input in steps:
            watched.step(elapsed, given_input)
    return watched


accelerations = st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0))


@settings(max_examples=3 * settings.default.max_examples)
@given(some_settings, accelerations, scenes)
def test_commands_continue_from_the_last_one_and_stops_only_shrink_them(first, wanted, acts):
    play(first, wanted, acts)


@given(some_settings, accelerations, scenes)
def test_rate_limits_and_stop_ramps_hold_without_a_start_ramp(first, wanted, acts):
    none = {'start_ramp': 0.0}
    acts = [(event | none if isinstance(event, dict) else event, steps) for event, steps in acts]
    play(first | none, wanted, acts)


@given(some_settings, accelerations, scenes, some_settings)
def test_every_stop_ends_at_zero_and_every_blend_at_the_computed_efforts(
    first, wanted, acts, last
):
    watched = play(first, wanted, acts)
    ours = watched.arm.loop
    watched.happen('resume')
    last = last | {'effort_rate_limits': math.inf}
    watched.happen(last)
    watched.step(0.01)
    for _ in range(60):
        watched.step(0.05)
    fresh = Arm(is_observed=False, settings=Settings(**last | {'start_ramp': 0.0}))
    for link, payload in ours.loads.payloads.items():
        fresh.loop.loads.set_payload(link, *payload)
    followed = reference(0.0, None, None, wanted, watched.added)
    expected = fresh.at(0.0, Q, QD, followed)
    assert ours.phase in COMPUTING_PHASES
    assert np.allclose(watched.last, expected, rtol=0.0, atol=ROUNDING)
    assert (np.abs(watched.last) <= ours.limits).all()
    watched.happen('stop')
    watched.step(0.01)
    assert (watched.last != 0.0).any() == (last['stop_ramp'] > 0.0 and expected.any())
    for _ in range(12):
        watched.step(0.05)
    assert watched.last.tolist() == [0.0, 0.0]


loads = st.one_of(
    st.tuples(st.just('payload'), st.sampled_from([0.0, 0.5, 3.0])),
    st.tuples(st.just('wrench'), st.sampled_from([0.0, 20.0, -20.0])),
    st.tuples(st.just('gravity'), st.sampled_from([0.0, 0.1, 1.0, -9.8])),
    st.tuples(st.just('turning'), st.sampled_from([0.001, 0.01, 0.019])),
)


def set_load(loop, now, kind, value):
    link, nothing = LINK, np.zeros(3)
    if kind == 'payload':
        loop.loads.set_payload(link, value, nothing, np.zeros((3, 3)))
    elif kind == 'wrench':
        loop.loads.set_external_wrench(now, link, (value, 0.0, 0.0), nothing)
    elif kind == 'gravity':
        loop.loads.set_gravity((value, 0.0, -9.8), now)
    else:  # slowly, as a base that turns
        loop.loads.set_gravity(loop.loads.gravity + np.array([10.0 * value, 0.0, 0.0]), now)


@given(
    st.lists(st.tuples(loads, st.integers(0, 12)), max_size=30),
    st.sampled_from([SHORTEST, 1.0]),
    st.sampled_from([0.0, 0.05, 1.0]),
)
def test_efforts_change_no_faster_than_a_blend_whatever_loads_arrive(events, ramp, timeout):
    chosen = Settings(start_ramp=ramp, wrench_timeout=timeout, use_urdf_effort_limits=False)
    loop, now, arrivals = unobserved(ControlLoop(PLANAR, settings=chosen)), 100.0, {}
    last, largest, at_once = np.zeros(2), np.zeros(2), np.zeros(2)

    def step():
        nonlocal now, last, largest, at_once
        now += 0.01
        store_state(loop.collector, now, PLANAR.joint_names, Q, QD)
        command = loop.step(now).efforts.copy()
        largest = np.maximum(largest, np.abs(loop.dynamics.efforts(Q, QD, np.zeros(2))))
        bound = 2.0 * largest * 0.01 / ramp + at_once + ROUNDING
        assert (np.abs(command - last) <= bound).all()
        last, at_once = command, np.zeros(2)
        largest = np.maximum(largest, np.abs(command))

    for _ in range(200):
        step()
    for (kind, value), steps in events:
        before = loop.dynamics.efforts(Q, QD, np.zeros(2))
        set_load(loop, now, kind, value)
        after = loop.dynamics.efforts(Q, QD, np.zeros(2))
        largest = np.maximum(largest, np.abs(after))
        name = 'gravity' if kind == 'turning' else kind
        longest = {'wrench': timeout, 'turning': 0.05}.get(kind, -1.0)
        if now - arrivals.get(name, -math.inf) <= longest:
            at_once += np.abs(after - before)
        arrivals[name] = now
        for _ in range(steps):
            step()
    for _ in range(300):
        step()
    expected = InverseDynamics(PLANAR, loop.loads.gravity)
    for link, payload in loop.loads.payloads.items():
        expected.set_payload(link, *payload)
    assert last == pytest.approx(expected.efforts(Q, QD, np.zeros(2)))
