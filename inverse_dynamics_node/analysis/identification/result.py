"""Holds the result of an identification, and exports a URDF and node parameters."""

from __future__ import annotations

from dataclasses import dataclass, field
import os

from ...robot.model import Floats, RobotModel
from ...robot.rigid_body import RigidBody
from ...robot.urdf.writer import Friction, rewrite
from ..node_parameters import node_parameters
from ..recordings.signals import Motion


@dataclass(frozen=True)
class Residuals:
    """RMS of measured minus modelled efforts [N m or N]."""

    urdf: float
    """Residual of the unchanged robot description, without friction."""
    friction: float
    """Residual of the robot description with fitted friction and offsets."""
    identified: float
    """Residual of the identified model."""


@dataclass(frozen=True)
class DriveTerms:
    """Identified terms of one joint, with standard errors."""

    damping: float = 0.0
    """Damping [N m s/rad or N s/m]."""
    coulomb: float = 0.0
    """Coulomb friction [N m or N]."""
    width: float = 0.0
    """Speed over which Coulomb friction is smoothed [rad/s or m/s]."""
    load_friction: float = 0.0
    """Ratio of Coulomb friction to the effort that loads the gear [-]."""
    armature: float = 0.0
    """Armature [kg m^2 or kg]."""
    coupling: float = 0.0
    """Rotation of the drive per rotation of the preceding joint [-]."""
    stiffness: float = 0.0
    """Stiffness of a spring or counterweight [N m/rad or N/m]."""
    rest: float = 0.0
    """Position at which the spring exerts no effort [rad or m]."""
    offset: float = 0.0
    """Offset of the effort [N m or N]; 0 if there is a spring, because `rest` includes it."""
    errors: dict[str, float] = field(default_factory=dict)
    """Standard errors of the identified terms, by name."""


@dataclass(frozen=True)
class JointResult:
    """Identification result of one joint with measured efforts."""

    name: str
    is_prismatic: bool
    measured: float
    """RMS of the measured effort in unseen data [N m or N]."""
    unseen: Residuals
    noise: float
    """Noise in the smoothed effort [N m or N]."""
    terms: DriveTerms
    """Identified terms; if the model was not accepted, the terms of a friction-only fit."""
    unknown_because: str
    """Reason why the friction is unknown; empty if the friction is known."""
    coupled_with: tuple[str, ...]
    """Joints that share a drive with this joint."""
    gain: float | None = None
    """Effort per recorded current; None if efforts were recorded."""

    @property
    def unit(self) -> str:
        """Unit of the effort."""
        return 'N' if self.is_prismatic else 'N m'


@dataclass(frozen=True, eq=False)
class BodyResult:
    """Identification result of one link, or of several links connected by fixed joints."""

    link: str
    """First link in `links`."""
    links: tuple[str, ...]
    """Identified links of the body."""
    mass_before: float
    """Mass in the robot description [kg]."""
    mass: float
    mass_error: float
    com_before: Floats
    """Centre of mass in the robot description, relative to the joint frame, shape (3,) [m]."""
    com: Floats
    com_error: Floats


@dataclass(frozen=True, eq=False)
class Unseen:
    """Measured and predicted efforts, usually of data that were not used for the fit."""

    times: Floats
    """Times of the samples, with all recordings placed in sequence, shape (samples,) [s]."""
    measured: Floats
    urdf: Floats
    friction: Floats
    identified: Floats
    description: str
    smoothing: float
    """Length of the smoothing window [s]."""


@dataclass(frozen=True, eq=False)
class IdentificationResult:
    """An identified robot, and the quality of its predictions."""

    robot: RobotModel
    """The robot description."""
    calibrated: RobotModel
    """Robot with the identified bodies; equal to `robot` if the model was not accepted."""
    accepted: bool
    """Whether the identified model predicts unseen data well enough."""
    verdict: str
    are_currents: bool
    """Whether motor currents were recorded instead of efforts."""
    joints: tuple[JointResult, ...]
    bodies: tuple[BodyResult, ...]
    inertials: dict[str, RigidBody]
    """New inertials in the link frames, by link; empty if the model was not accepted."""
    unseen: Unseen
    urdf_weight: float
    """Weight of the robot description in the fit."""
    scale: tuple[float, float] | None
    """How many times as large as modelled all efforts are, with error; None if not significant."""
    delay: float
    """Delay of the measured efforts [s]."""
    delay_error: float
    delay_removed: float
    """Delay that was removed for the fit [s]."""
    smoothing: float
    """Length of the smoothing window in the fit [s]."""
    sample_count: int
    duration: float
    """Duration of the recordings [s]."""
    signals: tuple[Motion, ...]
    """The smoothed recordings, with notes about the signals."""
    warnings: tuple[tuple[str, str], ...]
    """Warnings, each with a hint."""


def calibrated_urdf(result: IdentificationResult, path_or_xml: str | os.PathLike[str]) -> bytes:
    """
    Return the robot description with identified inertials and friction.

    `path_or_xml` is the original robot description. Only inertials and friction change. If the
    model was not accepted, only friction changes.

    """
    robot = result.robot
    friction = {
        joint.name: Friction(joint.terms.damping, joint.terms.coulomb)
        for joint in result.joints
        if not joint.unknown_because
    }
    # The fitted friction includes the friction of mimic joints.
    for body in range(1, len(robot.parent)):
        name = robot.body_names[body]
        master = robot.joint_names[int(robot.joint_index[body])]
        if name != master and master in friction:
            friction[name] = Friction(0.0, 0.0)
    return rewrite(path_or_xml, result.inertials, friction)


_TITLE = (
    'Identified from recordings. Units for revolute joints (prismatic joints):',
    'damping N m s/rad (N s/m), coulomb N m (N), coulomb_width rad/s (m/s),',
    'armature kg m^2 (kg). An offset of the efforts belongs into the driver.',
)
_EXTRAS = {
    'drive_coupling': 'coupling',
    'spring_stiffness': 'stiffness',
    'spring_rest': 'rest',
}
"""Attributes of `DriveTerms` by node parameter; a parameter is omitted if 0 for all joints."""


def identified_parameters(result: IdentificationResult) -> str:
    """Return the identified joint terms as node parameters in YAML."""
    joints = result.joints

    def known(name: str, unknown: float) -> list[float]:
        return [unknown if j.unknown_because else getattr(j.terms, name) for j in joints]

    extras = {name: known(term, 0.0) for name, term in _EXTRAS.items()}
    return node_parameters(
        _TITLE,
        [joint.name for joint in joints],
        {joint.name: joint.unknown_because for joint in joints if joint.unknown_because},
        {
            'damping': known('damping', -1.0),
            'coulomb': known('coulomb', -1.0),
            'coulomb_width': known('width', 0.01),
            'load_friction': known('load_friction', 0.0),
            'armature': [joint.terms.armature for joint in joints],
            **{name: values for name, values in extras.items() if any(values)},
        },
    )
