"""Robots with more joints and branches than the arms: a two-armed robot and a hand."""


def two_arms():
    """Return a URDF of a torso with two arms of seven joints and a hand of five on each."""
    parts = [_link('base_link', 30.0)]
    parts += _chain('base_link', 'torso', [('lift', 'z', 800), ('yaw', 'z', None)], 0.3, 12.0)
    for side, sign in (('left', 1), ('right', -1)):
        kinds = [
            ('shoulder_pan', 'z', 90),
            ('shoulder_lift', 'y', 90),
            ('upper_arm_roll', 'x', 60),
            ('elbow', 'y', 60),
            ('forearm_roll', 'x', None),
            ('wrist_flex', 'y', 25),
            ('wrist_roll', 'x', None),
        ]
        parts += _chain('torso_yaw_link', f'{side}_arm', kinds, 0.2, 2.0, (0, 0.2 * sign, 0.2))
        for k in range(5):
            kinds = [('finger', 'y', 3)]
            where = (0.05, 0.02 * (k - 2), 0)
            parts += _chain(
                f'{side}_arm_wrist_roll_link', f'{side}_hand_{k + 1}', kinds, 0.04, 0.05, where
            )
    return f'<robot name="two_arms">{"".join(parts)}</robot>'


def three_finger_hand():
    """Return a URDF of a wrist and three fingers of three joints."""
    parts = [_link('forearm', 0.8)]
    parts += _chain('forearm', 'wrist', [('flex', 'y', 6), ('deviation', 'z', 6)], 0.05, 0.3)
    for k, where in enumerate(((0.06, 0.03, 0), (0.06, -0.03, 0), (0.03, 0, 0.04)), 1):
        kinds = [('spread', 'z', 1), ('proximal', 'y', 1), ('distal', 'y', 0.5)]
        parts += _chain('wrist_deviation_link', f'finger_{k}', kinds, 0.04, 0.04, where)
    return f'<robot name="three_finger_hand">{"".join(parts)}</robot>'


def _chain(parent, prefix, kinds, length, mass, first=(0, 0, 0)):
    parts, where = [], first
    for name, axis, effort in kinds:
        joint = f'{prefix}_{name}'
        direction = ' '.join(str(int(axis == letter)) for letter in 'xyz')
        kind = 'prismatic' if name == 'lift' else 'revolute' if effort else 'continuous'
        limit = (
            f'<limit lower="{0.0 if kind == "prismatic" else -1.9}" upper="0.4" effort="{effort}" '
            'velocity="3"/>'
        )
        parts.append(_link(f'{joint}_link', mass, 0.5 * length))
        parts.append(
            f'<joint name="{joint}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{joint}_link"/><origin xyz="{" ".join(map(str, where))}"/>'
            f'<axis xyz="{direction}"/>{limit if effort else ""}</joint>'
        )
        parent, where = f'{joint}_link', (length, 0, 0)
        mass *= 0.85
    return parts


def _link(name, mass, x=0.0):
    ixx, iyy = 1e-3 * mass, 2e-3 * mass
    return (
        f'<link name="{name}"><inertial><origin xyz="{x} 0 0"/><mass value="{mass}"/>'
        f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{iyy}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
