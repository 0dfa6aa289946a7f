"""Jobs of a machining centre: holes that are drilled, feet that go on; refused as a whole.

A job is checked before anything moves: every operation from where the one before it ends, with
legs, locks and wrenches.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from parapod.systems.core.batching import first_of_largest
from parapod.systems.core.errors import ParapodError, UnreachablePosture
from parapod.systems.core.vectors import Array, rotation_columns
from parapod.systems.machining_centre.geometry import CentreGeometry, leg_name
from parapod.systems.machining_centre.panel import Panel
from parapod.systems.machining_centre.paths import (
    Speeds,
    duration_of,
    foot_at,
    platform_at,
    swing_duration,
)
from parapod.systems.machining_centre.platform_mode import (
    displacement,
    inverse_kinematics,
    leg_lengths,
)
from parapod.systems.machining_centre.posture import Posture
from parapod.systems.machining_centre.statics import CentreMasses
from parapod.systems.machining_centre.swing import (
    Locks,
    LockSet,
    SingularSwing,
    SwingPose,
    close_locks,
    legs_alone,
    lock_conditions,
    swing_inverse,
    turns,
)
from parapod.systems.machining_centre.wrench import wrench_indices

# Lean of a foot's frame from the panel's normal that a clamp bears [rad].
LARGEST_LEAN = 0.05
# Newton's method ends with a step that leaves some micrometres of the paper's centre at most, and
# nothing at rest [m], where locks were off by no more than that [rad].
_LAST_STEP, _TOLERANCE = 2e-3, 0.05
# Shares of the clearance above the panel that the drill keeps on a way, which may be straight
# where the panel is not, and where the platform stays when everything is stopped.
_FREE, _RETRACTED = 0.5, 0.95
# Poses at which a way of the platform, and of a foot, is looked at.
_LOOKS_OF_PLATFORM, LOOKS_OF_FOOT = 12, 24
_SAME_SPEED = 1e-9  # difference of two legs' speeds that is rounding [m/s]


class Refused(ParapodError):
    """An operation that a centre does not begin.

    Attributes:
        operation: its number in the job, from 1; 0: not known.
    """

    def __init__(self, words: str, operation: int = 0):
        self.operation, self.words = operation, words
        super().__init__(f"operation {operation}: {words}" if operation else words)


@dataclass(frozen=True)
class Process:
    """The drill, and what drilling needs.

    Attributes:
        tool_length: from P_O to the drill's tip, along the platform's third axis backwards [m].
        thrust: thrust of the material on the drill at the intended feed [N].
        torque: torque of the material on the drill [N m].
        clearance: height of the tip above the panel, between holes [m].
        largest_leg_force: largest force of each leg, pushing and pulling [N].
        masses: masses of the centre.
    """

    tool_length: float = CentreGeometry.tool_length
    thrust: float = 150.0
    torque: float = 0.6
    clearance: float = 0.01
    largest_leg_force: float = 1000.0
    masses: CentreMasses = field(default_factory=CentreMasses)

    def tip(self, pose: Array) -> Array:
        """Places (..., 3) of the drill's tip at poses (..., 6) of the platform [m]."""
        out = np.stack(rotation_columns(pose[..., 3], pose[..., 4], pose[..., 5])[2], axis=-1)
        tip: Array = pose[..., :3] - self.tool_length * out
        return tip

    def wrench(self, geometry: CentreGeometry, pose: Array) -> Array:
        """Wrench (6) [moment; force] of drill and weight at P_O in the world [N m, N]."""
        out = Rotation.from_euler("xyz", pose[3:]).as_matrix()[:, 2]
        return self.masses.weight(geometry) + np.concatenate(
            (self.torque * out, self.thrust * out)
        )


@dataclass(frozen=True, eq=False)
class Drill:
    """A hole.

    Attributes:
        hole: (6) frame at the panel's surface, third axis out of the hole; the platform has its
            rotation [m, rad].
        depth: depth of the hole [m].
    """

    hole: Array
    depth: float

    def pose(self, process: Process, height: float) -> Array:
        """Pose (6) of the platform with the tip at a height above the hole, along its axis."""
        out = Rotation.from_euler("xyz", self.hole[3:]).as_matrix()[:, 2]
        origin = self.hole[:3] + (process.tool_length + height) * out
        return np.concatenate((origin, self.hole[3:]))


@dataclass(frozen=True, eq=False)
class Swing:
    """A foot that goes on.

    Attributes:
        pose: (6) of the platform from which it begins [m, rad].
        lock_set: limb, and what is locked meanwhile.
        foothold: (6) where the foot is to stand; it may turn about the third axis [m, rad].
        way: (k, 6) of the platform meanwhile, at equal shares of the time [m, rad]; it decides
            what foot and locks leave open. None: the platform goes to the nearest poses.
    """

    pose: Array
    lock_set: LockSet
    foothold: Array
    way: Array | None = None


type Operation = Drill | Swing


@dataclass(frozen=True, eq=False)
class Job:
    """Operations one after the other, and how they are done.

    Attributes:
        operations: the operations.
        panel: panel on which the centre stands and which it drills.
        process: the drill.
        speeds: limits of speed.
        lift: height of a swing [m].
        drift: speed of the platform in directions that foot and locks leave open, to better
            stroke and wrench index [m/s].
        least_sigma: smallest singular value with which a foot is swung, see `lock_conditions`.
    """

    operations: tuple[Operation, ...] = ()
    panel: Panel = field(default_factory=Panel)
    process: Process = field(default_factory=Process)
    speeds: Speeds = field(default_factory=Speeds)
    lift: float = 0.03
    drift: float = 0.004
    least_sigma: float = 0.05


class Carried(NamedTuple):
    """Wrench that a pose carries, and what is asked of it.

    Attributes:
        w_minmax: wrench index w_minmax of the posture [-].
        capacity: magnitude that is resisted in every direction [N].
        needed: magnitude of drill and weight [N], moments divided by r_c.
    """

    w_minmax: float
    capacity: float
    needed: float


def carried(geometry: CentreGeometry, process: Process, pose: Array, feet: Array) -> Carried:
    """Wrench that a clamped centre carries at a pose, and that of drill and weight.

    Args:
        geometry: the centre.
        process: the drill.
        pose: (6) of the platform [m, rad].
        feet: (n, 6) of the feet [m, rad].
    """
    w_minmax = float(wrench_indices(geometry, pose, feet).w_minmax)
    wrench = process.wrench(geometry, pose)
    wrench[:3] /= geometry.platform_radius
    capacity = w_minmax * geometry.legs * process.largest_leg_force
    return Carried(w_minmax, capacity, float(np.linalg.norm(wrench)))


def check_drill(geometry: CentreGeometry, job: Job, drill: Drill, feet: Array) -> None:
    """Refuses a hole that the legs do not reach, or at which they do not carry the drill.

    Raises:
        Refused: names the leg, or pose, index and force.
    """
    process = job.process
    hard: list[tuple[float, Array, Carried]] = []
    alone = float(np.linalg.norm(process.masses.weight(geometry)))
    for height in (process.clearance, 0.0, -drill.depth):
        pose = drill.pose(process, height)
        _check_pose(geometry, pose, feet)
        load = carried(geometry, process, pose, feet)
        if max(alone, load.needed) > load.capacity:
            hard.append((_admissible(geometry, process, pose, load.capacity), pose, load))
    if not hard:
        return
    thrust, pose, load = min(hard, key=lambda each: each[0])
    resisted = (
        f"at {_place(pose)} legs of {process.largest_leg_force:g} N resist {load.capacity:.0f} N "
        f"in every direction (w_minmax {load.w_minmax:.4f}), and"
    )
    if alone > load.capacity:
        raise Refused(f"{resisted} the weight alone needs {alone:.0f} N: no thrust would do")
    raise Refused(
        f"{resisted} drill and weight need {load.needed:.0f} N: a thrust of "
        f"{math.floor(thrust)} N would do"
    )


def _admissible(geometry: CentreGeometry, process: Process, pose: Array, capacity: float) -> float:
    """Largest thrust that is carried with the process's torque; 0: none is [N]."""
    wrench = replace(process, thrust=0.0).wrench(geometry, pose)
    wrench[:3] /= geometry.platform_radius
    out = Rotation.from_euler("xyz", pose[3:]).as_matrix()[:, 2]
    along = float(wrench[3:] @ out)
    reserve = along**2 - float(wrench @ wrench) + capacity**2
    return max(0.0, math.sqrt(reserve) - along) if reserve > 0.0 else 0.0


def check_footholds(geometry: CentreGeometry, panel: Panel, feet: Array) -> None:
    """Refuses footholds that overlap, are off the panel, or do not face out of it.

    Args:
        geometry: the centre.
        panel: the panel.
        feet: (n, 6) of the feet [m, rad].

    Raises:
        Refused: names the limbs.
    """
    for i, foot in enumerate(feet, start=1):
        if not np.isfinite(foot).all():
            raise Refused(f"the foothold of limb {i} is not finite")
        height, lean = float(panel.place(foot[:3])[2]) - panel.foot_height, panel.tilt(foot)
        if not abs(height) <= 1e-3:
            raise Refused(f"the foothold of limb {i} is {1e3 * height:.1f} mm off the panel")
        if not lean <= LARGEST_LEAN:
            raise Refused(
                f"the foothold of limb {i} faces away: its axis leans {np.degrees(lean):.1f} deg "
                f"from the panel's normal, and may by {np.degrees(LARGEST_LEAN):.1f}"
            )
    for i in range(len(feet)):
        for j in range(i + 1, len(feet)):
            apart = float(np.linalg.norm(feet[i, :3] - feet[j, :3]))
            if not apart >= geometry.foot_diameter:
                raise Refused(
                    f"the footholds of limbs {i + 1} and {j + 1} overlap: {1e3 * apart:.0f} mm "
                    f"are between them, and {1e3 * geometry.foot_diameter:.0f} are needed"
                )


class Swung(NamedTuple):
    """A swing that can be made.

    Attributes:
        end: platform and feet at its end.
        sigma: smallest singular value on its way, of locked joints and of what holds.
        margin: smallest distance of a leg from the ends of its stroke [m].
        way: see `Swing`.
    """

    end: Posture
    sigma: float
    margin: float
    way: Array


def try_swing(
    geometry: CentreGeometry,
    job: Job,
    swing: Swing,
    feet: Array,
    looks: int = LOOKS_OF_FOOT,
) -> Swung:
    """Swings a foot, on paper.

    Args:
        geometry: the centre.
        job: its panel and limits are taken.
        swing: the swing.
        feet: (n, 6) of the feet before [m, rad].
        looks: postures on its way that are looked at.

    Raises:
        Refused: names what does not fit.
    """
    limb = swing.lock_set.limb
    goal = feet.copy()
    goal[limb - 1] = swing.foothold
    check_footholds(geometry, job.panel, goal)
    _check_pose(geometry, swing.pose, feet)
    try:
        locks = close_locks(geometry, swing.pose, swing.lock_set, feet, along="left")
    except ValueError as error:
        raise Refused(str(error)) from None
    pose, now, sigma, margin = swing.pose, feet.copy(), np.inf, np.inf
    way, lengths = [], []
    duration = swing_duration(feet[limb - 1], swing.foothold, job.lift, job.speeds)
    by = displacement(feet[limb - 1], swing.foothold)
    for share in np.linspace(0.0, 1.0, looks + 1):
        foot = foot_at(feet[limb - 1], swing.foothold, by, job.lift, share)
        try:
            freedom = 16.0 * (share * (1.0 - share)) ** 2 * job.drift * duration / looks
            swung = swung_to(geometry, locks, foot, pose, freedom=freedom)
        except (SingularSwing, UnreachablePosture) as error:
            raise Refused(str(error)) from None
        pose, now[limb - 1] = swung.pose, swung.foot_pose
        way.append(pose)
        lengths.append(swung.lengths)
        at = lock_conditions(
            geometry, pose, swing.lock_set, now, along="left", turns=turns(geometry)
        )
        sigma = min(sigma, float(at.inverse), float(at.holding))
        if not sigma >= job.least_sigma:
            raise Refused(
                f"limb {limb} would swing past a singularity: the smallest singular value is "
                f"{sigma:.3f}, and {job.least_sigma:g} are needed; lock other joints than "
                f"{_named(swing.lock_set)}"
            )
        _check_tip(job, pose)
        near = min(
            swung.lengths.min() - geometry.stroke_min, geometry.stroke_max - swung.lengths.max()
        )
        margin = min(margin, float(near))
    _check_tip(job, pose, _RETRACTED)
    _check_speeds(job, np.array(lengths), duration, "swing")
    return Swung(Posture(pose, now), sigma, margin, np.array(way))


def swung_to(
    geometry: CentreGeometry,
    locks: Locks,
    foot: Array,
    near: Array,
    *,
    toward: Array | None = None,
    freedom: float = 0.0,
) -> SwingPose:
    """The posture with a swinging foot at a pose, a moment after another posture.

    Args:
        geometry: the centre.
        locks: locks that are closed.
        foot: (6) of the loose foot now, see `foot_at` [m, rad].
        near: (6) of the platform a moment ago [m, rad].
        toward: see `swing_inverse`.
        freedom: see there.

    Raises:
        SingularSwing: see `swing_inverse`.
        UnreachablePosture: a leg would leave its stroke.
    """
    return swing_inverse(
        *(geometry, foot, locks, near),
        turns=turns(geometry),
        freedom=freedom,
        toward=toward,
        tolerance=_TOLERANCE,
        last_step=_LAST_STEP * geometry.size,
    )


def swung_alone_to(
    geometry: CentreGeometry, locks: Locks, feet: Array, near: Array, toward: Array | None
) -> tuple[Array, Array, Array]:
    """Lengths and poses of rows, each as `swung_to` has them; see `legs_alone`."""
    return legs_alone(
        *(geometry, feet, locks, near),
        turns=turns(geometry),
        toward=toward,
        tolerance=_TOLERANCE,
        last_step=_LAST_STEP * geometry.size,
    )


def check_job(geometry: CentreGeometry, job: Job, beginning: Posture) -> Posture:
    """Refuses a job of which something cannot be done; names where it ends.

    Args:
        geometry: the centre.
        job: the job.
        beginning: platform and feet before.

    Raises:
        Refused: names the operation and why.
    """
    now = beginning
    try:
        check_footholds(geometry, job.panel, now.feet)
        _check_pose(geometry, now.pose, now.feet)
    except Refused as error:
        raise Refused(f"the beginning: {error.words}") from None
    for number, operation in enumerate(job.operations, start=1):
        try:
            if isinstance(operation, Drill):
                above = operation.pose(job.process, job.process.clearance)
                poses = _check_way(geometry, job, now.pose, above, now.feet)
                _check_weight(geometry, job.process, poses, now.feet)
                check_drill(geometry, job, operation, now.feet)
                now = Posture(above, now.feet)
            else:
                _check_way(geometry, job, now.pose, operation.pose, now.feet)
                now = try_swing(geometry, job, operation, now.feet).end
        except Refused as error:
            raise Refused(error.words, number) from None
    return now


def _check_way(
    geometry: CentreGeometry, job: Job, start: Array, end: Array, feet: Array
) -> list[Array]:
    """Poses of the platform on its way, all of which it can take as fast as it is led."""
    by, speeds = displacement(start, end), job.speeds
    poses = [platform_at(start, by, share) for share in np.linspace(0.0, 1.0, _LOOKS_OF_PLATFORM)]
    for pose in poses:
        _check_pose(geometry, pose, feet)
        _check_tip(job, pose)
    duration = duration_of(start, end, speeds, speeds.rapid)
    lengths = leg_lengths(geometry, np.array(poses), feet)
    _check_speeds(job, lengths, duration, "rapid")
    return poses


def _check_weight(
    geometry: CentreGeometry, process: Process, poses: list[Array], feet: Array
) -> None:
    """Refuses legs that do not carry the platform on its way to a hole."""
    indices = wrench_indices(geometry, np.array(poses), feet).w_minmax
    hardest = int(np.argmin(indices))
    alone = float(np.linalg.norm(process.masses.weight(geometry)))
    capacity = float(indices[hardest]) * geometry.legs * process.largest_leg_force
    if alone > capacity:
        needed = math.ceil(process.largest_leg_force * alone / capacity)
        raise Refused(
            f"on the way, at {_place(poses[hardest])}, legs of {process.largest_leg_force:g} N "
            f"resist {capacity:.0f} N in every direction, and the weight needs {alone:.0f} N: "
            f"legs of {needed} N would do"
        )


def _check_speeds(job: Job, lengths: Array, duration: float, which: str) -> None:
    """Refuses legs that would have to be too fast.

    Args:
        job: its speeds are taken.
        lengths: (k, 2n) at equal steps of a duration [m].
        duration: [s].
        which: speed that is to blame.
    """
    rates = np.abs(np.diff(lengths, axis=0)) * (len(lengths) - 1) / duration
    *_, leg = first_of_largest(rates, _SAME_SPEED)
    fastest = float(rates.max())
    if fastest > job.speeds.leg:
        raise Refused(
            f"the {leg_name(leg)} would have to go at {1e3 * fastest:.0f} mm/s and may go at "
            f"{1e3 * job.speeds.leg:.0f}: a {which} speed that is {fastest / job.speeds.leg:.2f} "
            "times lower would do"
        )


def is_clear(job: Job, poses: Array) -> bool:
    """True if the drill is retracted at all of some poses (..., 6) of the platform [m, rad]."""
    heights = job.panel.place(job.process.tip(poses))[..., 2]
    return bool((heights >= _RETRACTED * job.process.clearance).all())


def _check_tip(job: Job, pose: Array, share: float = _FREE) -> None:
    """Refuses a drill that has less than a share of its clearance where nothing is drilled."""
    height = float(job.panel.place(job.process.tip(pose))[2])
    if not height >= share * job.process.clearance:
        raise Refused(
            f"the drill's tip would be {1e3 * height:.1f} mm above the panel with the platform at "
            f"{_place(pose)}: {1e3 * share * job.process.clearance:.1f} mm are needed"
        )


def _check_pose(geometry: CentreGeometry, pose: Array, feet: Array) -> None:
    try:
        inverse_kinematics(geometry, pose, feet)
    except UnreachablePosture as error:
        raise Refused(f"{_place(pose)} is out of reach: {error}") from None


def _named(lock_set: LockSet) -> str:
    return ", ".join(f"q{joint} of {limb}" for limb, joint in lock_set.standing) or "none"


def _place(pose: Array) -> str:
    """A pose for people, as in "(10, -20, 480) mm, (0.0, 5.0, 0.0) deg"."""
    place, angles = 1e3 * pose[:3], np.degrees(pose[3:])
    at, rotation = (
        ", ".join(texts)
        for texts in ([f"{value:.0f}" for value in place], [f"{value:.1f}" for value in angles])
    )
    return f"({at}) mm, ({rotation}) deg"


def row_of_holes(
    panel: Panel,
    start: tuple[float, float],
    heading: float,
    count: int,
    pitch: float,
    tilt: float = 0.0,
    depth: float = 0.008,
    yaw: float = 0.0,
) -> tuple[Drill, ...]:
    """Holes in a row on the panel.

    Args:
        panel: the panel.
        start: ways along and across (2) of the row's middle [m].
        heading: direction of the row, from the way along [rad].
        count: number of holes.
        pitch: between two of them [m].
        tilt: angle of the holes' axes from the panel's normals, towards the row's end [rad].
        depth: depth of the holes [m].
        yaw: heading of the platform over them [rad].
    """
    holes = []
    for k in range(count):
        way = (k - 0.5 * (count - 1)) * pitch
        along, across = (
            start[0] + way * np.cos(heading),
            start[1] + way * np.sin(heading),
        )
        frame = panel.frame(along, across)
        lean = Rotation.from_rotvec(tilt * np.array((-np.sin(heading), np.cos(heading), 0.0)))
        rotation = Rotation.from_euler("xyz", frame[3:]) * lean * Rotation.from_euler("z", yaw)
        holes.append(Drill(np.concatenate((frame[:3], rotation.as_euler("xyz"))), depth))
    return tuple(holes)


def standing(geometry: CentreGeometry, panel: Panel, height: float) -> Posture:
    """The paper's pattern laid on a panel about the world's origin, the platform above it [m]."""
    feet = [
        panel.foothold(
            geometry.pattern_radius * np.cos(angle), geometry.pattern_radius * np.sin(angle), angle
        )
        for angle in geometry.angles
    ]
    return Posture(panel.frame(0.0, 0.0, height=height), np.array(feet))


def drills(operations: Sequence[Operation]) -> int:
    """Number of holes among operations."""
    return sum(isinstance(operation, Drill) for operation in operations)
