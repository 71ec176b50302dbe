"""The result of a probe of the commands, as text and as JSON."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import math
from typing import Any

from ..analysis.probe import FAULTS, JointResult, Push, Verdict
from ..errors import listed, significant
from ..robot.model import RobotModel
from .tables import table

_SMALLEST = 0.001  # [N m or N]; smaller efforts are shown as 0


def probe_verdict(results: Sequence[JointResult], joints: Sequence[str], reason: str) -> str:
    """Return a sentence about the whole probe; `reason` says why the node stopped, if it did."""
    fault = next((result for result in results if result.verdict in FAULTS), None)
    if fault is not None:
        why = f' ({reason})' if reason else ''
        return f'{_describe(fault)}{why}. The efforts are zero: the arm is not held.'
    if reason:
        return f'The node has stopped the arm: {reason}.'
    undecided = [result for result in results if result.verdict is not Verdict.RIGHT]
    if undecided:
        rest = '; '.join(_describe(result) for result in undecided)
        return f'No fault was found, but not every joint could be probed: {rest}.'
    unknown = [result.joint for result in results if math.isnan(result.scale)]
    text = f'All {len(joints)} joints move as commanded.'
    if unknown:
        text += f' Friction hides the scale of the commands of {listed(unknown)}.'
    return text


def _describe(result: JointResult) -> str:
    """Describe a verdict other than `RIGHT`."""
    joint, push = result.joint, result.pushes[-1]
    if result.verdict is Verdict.WRONG_SIGN:
        return f'{joint} moves against its commands: the sign is wrong'
    if result.verdict is Verdict.WRONG_JOINT:
        return f'the commands of {joint} move {push.moved}: the order of the joints is wrong'
    if result.verdict is Verdict.WRONG_SCALE:
        if result.scale > 1.0:
            return (
                f'{joint} accelerates {significant(result.scale, 2)} times as fast as the model: '
                'the commands are too large, or the inertia in the model is'
            )
        return (
            f'{joint} accelerates {significant(1.0 / result.scale, 2)} times as slowly as the '
            'model: the commands are too small, or the model lacks the inertia of the rotor '
            '(armature)'
        )
    if result.verdict is Verdict.WRONG_LOAD:
        return (
            f'{joint} breaks away at {significant(result.pushes[0].effort)} and '
            f'{significant(result.pushes[1].effort)}: the efforts that hold it '
            f'({significant(result.load)}) are wrong by about {significant(result.load_error)}'
        )
    if result.verdict is Verdict.NOT_MOVED:
        return (
            f'{joint} did not move with {significant(push.effort)}: brakes, a position controller '
            'or friction hold it, or the commands do not reach it'
        )
    if result.verdict is Verdict.NO_ROOM:
        return f'{joint} is at a position limit'
    if result.verdict is Verdict.RESTLESS:
        return f'the arm does not rest, so {joint} was not pushed'
    return f'the node stopped the arm when {joint} was pushed'


def probe_table(results: Sequence[JointResult], robot: RobotModel) -> str:
    """Return a table with a row for each joint."""
    rows = []
    for result in results:
        i = robot.joint_names.index(result.joint)
        unit = 'N' if robot.is_prismatic_joint[i] else 'N m'
        pushes = [*result.pushes, *[None] * 2][:2]
        rows.append(
            (
                result.joint,
                *(_effort(push) for push in pushes),
                unit,
                '-' if math.isnan(result.scale) else f'{result.scale:.2f}',
                result.verdict.value,
            )
        )
    columns = 'joint', 'breaks away at +', '-', '', 'acceleration / model', 'verdict'
    return table('Pushes of the joints', columns, rows, words=(3, 5))


def _effort(push: Push | None) -> str:
    if push is None or math.isnan(push.effort):
        return '-'
    return significant(push.effort, 2) if push.effort > _SMALLEST else '0'


def as_json(results: Iterable[JointResult], reason: str) -> dict[str, Any]:
    """Return the result as JSON; unknown numbers are null."""
    return {
        'stopped': reason or None,
        'joints': [
            {
                'name': result.joint,
                'verdict': result.verdict.value,
                'breakaway': [_known(push.effort) for push in result.pushes],
                'moved': [push.moved or None for push in result.pushes],
                'scale': _known(result.scale),
                'load': _known(result.load),
                'load_error': _known(result.load_error),
            }
            for result in results
        ],
    }


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
