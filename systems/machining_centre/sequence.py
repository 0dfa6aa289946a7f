"""The sequence of a job: phases, what they move and switch, and what ends each of them.

One table shows, for every phase, what moves, which locks are closed and whether a foot is loose.
A foot is loose only in the phases of its own swing, so that two never are; and between a motion
and a lock or clamp that is switched there is a rest.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline  # type: ignore[import-untyped]

from parapod.systems.core.elementwise import Elementwise, either, least, negated, where
from parapod.systems.core.rows import (
    answer_of,
    common,
    matrix_of,
    numbers_of,
    shared,
    values_of,
)
from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.job import (
    Drill,
    Job,
    Operation,
    Refused,
    Swing,
    check_drill,
    is_clear,
    try_swing,
)
from parapod.systems.machining_centre.paths import (
    duration_of,
    foot_at,
    platform_at,
    swing_duration,
)
from parapod.systems.machining_centre.platform_mode import (
    displacement,
    leg_lengths,
    within_stroke,
)
from parapod.systems.machining_centre.posture import LOCKS_OF_LIMB, Posture
from parapod.systems.machining_centre.swing import LOCKABLE, LockSet, best_sets, turns


class Phase(IntEnum):
    """Phases; their numbers are those of the port `phase`."""

    WAITING = 0
    MACHINING = 1
    RECONFIGURATION = 2
    LOCK = 3
    UNCLAMP = 4
    SWING = 5
    CLAMP = 6
    UNLOCK = 7
    SETTLED = 8
    RETRACTION = 9
    DONE = 10
    STOPPED = 11
    FAULT = 12


class Rule(NamedTuple):
    """Rule of a phase.

    Attributes:
        moves: the moving thing: nothing, the platform, or a loose foot.
        locks: true if the swing's locks are closed.
        is_loose: true if the clamp of the swing's limb is open.
        switches: switches that are operated when it begins.
        follows: phase after it.
    """

    moves: Literal["", "platform", "foot"]
    locks: bool
    is_loose: bool
    switches: Literal["", "locks", "clamp"]
    follows: Phase | None


RULES = {
    Phase.WAITING: Rule("", False, False, "locks", Phase.SETTLED),
    Phase.MACHINING: Rule("platform", False, False, "", Phase.SETTLED),
    Phase.RECONFIGURATION: Rule("platform", False, False, "", Phase.LOCK),
    Phase.LOCK: Rule("", True, False, "locks", Phase.UNCLAMP),
    Phase.UNCLAMP: Rule("", True, True, "clamp", Phase.SWING),
    Phase.SWING: Rule("foot", True, True, "", Phase.CLAMP),
    Phase.CLAMP: Rule("", True, False, "clamp", Phase.UNLOCK),
    Phase.UNLOCK: Rule("", False, False, "locks", Phase.SETTLED),
    Phase.SETTLED: Rule("", False, False, "", None),
    Phase.RETRACTION: Rule("platform", False, False, "", Phase.STOPPED),
    Phase.DONE: Rule("", False, False, "", None),
    Phase.STOPPED: Rule("", False, False, "", None),
    Phase.FAULT: Rule("", False, False, "", None),
}


class Fault(IntEnum):
    """Reasons for which a job ends at once, everything standing where it is."""

    NONE = 0
    EMERGENCY_STOP = 1
    CLAMP_LOST = 2
    LOCK_LOST = 3
    SWITCH_LATE = 4
    OFF_COURSE = 5
    NOT_DETERMINED = 6
    UNDER_LOAD = 7
    REFUSED = 8
    NO_WAY = 9


_WORDS = {
    Fault.NONE: "nothing is wrong",
    Fault.EMERGENCY_STOP: "the emergency stop is pressed",
    Fault.CLAMP_LOST: "the clamp of limb {0} does not report that it is as commanded",
    Fault.LOCK_LOST: "a lock of limb {0} does not report that it is as commanded",
    Fault.SWITCH_LATE: "a lock or clamp of limb {0} has not switched in time",
    Fault.OFF_COURSE: "leg {0} is not where it was led to",
    Fault.NOT_DETERMINED: "legs, locks and clamps do not determine where the platform is",
    Fault.UNDER_LOAD: "the drill carries load where locks are to be switched",
    Fault.REFUSED: "operation {0} asks for more than its pose carries or reaches",
    Fault.NO_WAY: "operation {0} finds no lengths of the legs that lead on",
}


def words_of(fault: int, where: int) -> str:
    """A fault for people.

    Args:
        fault: its number.
        where: limb, leg or operation, see `Fault`.
    """
    return _WORDS[Fault(fault)].format(where)


@dataclass(frozen=True)
class SequenceParams:
    """Times and tolerances of a sequence; design choices.

    Attributes:
        begin: time at which the first operation begins [s].
        settling: for which legs rest before anything is switched, and switches before anything
            moves [s].
        switching: longest time in which locks and clamps switch, and legs come to rest [s].
        stopping: in which a motion that is stopped slows down [s].
        tolerance: distance of a leg from where it was led that counts as there [m].
        largest_error: distance at which it is off course [m].
        largest_load: thrust and torque at which the drill counts as free [N, N m].
    """

    begin: float = 0.5
    settling: float = 0.15
    switching: float = 2.0
    stopping: float = 0.3
    tolerance: float = 5e-4
    largest_error: float = 5e-3
    largest_load: float = 5.0


class Seen(NamedTuple):
    """Observations that a sequence goes by at an instant.

    Attributes:
        time: [s].
        locks: (n, 4) which locks report that they are closed.
        clamps: (n) which clamps do.
        feet: (n, 6) of the feet, as far as is known [m, rad].
        pose: (6) of the platform that is asked for now [m, rad].
        error: (2n) lengths of the legs less those that they were led to [m].
        load: (2) thrust and torque [N, N m].
        is_determined: true if the pose of the platform is known.
        is_stuck: true if no lengths lead on.
        is_pressed: true if the emergency stop is pressed.
        is_stopped: true if an operator asks for the job's end.
        asked: (7) pose of the platform and limb that a person asks for once the job is done
            [m, rad]; None: there is none.
    """

    time: float
    locks: NDArray[np.bool_]
    clamps: NDArray[np.bool_]
    feet: Array
    pose: Array
    error: Array
    load: Array
    is_determined: bool = True
    is_stuck: bool = False
    is_pressed: bool = False
    is_stopped: bool = False
    asked: Array | None = None


@dataclass(frozen=True, eq=False)
class Progress:
    """State of a job that goes on.

    Attributes:
        phase: see `Phase`.
        operation: number of operations that are done.
        move: number of the motion of a hole; the last one once what the operation is about is
            done.
        clock: time of the phase or motion; slower than real time where it is stopped [s].
        rate: rate of that clock [-].
        rest: for which everything has been as it should [s].
        waited: since the motion ended, or the phase began that has none [s].
        duration: duration of the motion; 0 where nothing moves [s].
        start: (6) pose of platform or foot where the motion began [m, rad].
        end: (6) pose where it ends.
        by: (6) displacement from one to the other [rad, m].
        fault: see `Fault`.
        where: limb, leg or operation that it is about.
        limb: limb whose foot is loose, or will be, from 1; 0: none.
        locked: locks that are closed while it is, a bit each.
        broken_off: phase in which the fault came: locks and clamps stay as they were in it.
    """

    phase: Phase = Phase.WAITING
    operation: int = 0
    move: int = 0
    clock: float = 0.0
    rate: float = 1.0
    rest: float = 0.0
    waited: float = 0.0
    duration: float = 0.0
    start: Array = field(default_factory=lambda: np.zeros(6))
    end: Array = field(default_factory=lambda: np.zeros(6))
    by: Array = field(default_factory=lambda: np.zeros(6))
    fault: Fault = Fault.NONE
    where: int = 0
    limb: int = 0
    locked: int = 0
    broken_off: Phase = Phase.WAITING

    @property
    def rule(self) -> Rule:
        """Rule of the phase."""
        return RULES[self.broken_off if self.phase is Phase.FAULT else self.phase]

    def failed(self, fault: Fault, where: int = 0) -> "Progress":
        """This progress, ended by a fault."""
        return replace(self, phase=Phase.FAULT, fault=fault, where=where, broken_off=self.phase)

    def numbers(self) -> Array:
        """All of it as numbers, or those of each row."""
        numbers = [getattr(self, name) for name in _NUMBERS]
        poses = np.concatenate((self.start, self.end, self.by), axis=-1)
        if poses.ndim == 1:
            return np.concatenate((numbers, poses))
        return np.hstack((matrix_of(numbers, len(poses)).T, poses))

    @classmethod
    def from_numbers(cls, numbers: Array) -> "Progress":
        """The progress of its numbers; rows in another phase, or of another whole number, part."""
        values, poses = np.split(numbers, (len(_NUMBERS),), axis=-1)
        named: dict[str, Any] = {
            name: value if kind is float else shared(kind, value)
            for (name, kind), value in zip(_NUMBERS.items(), numbers_of(values), strict=True)
        }
        start, end, by = np.split(poses.copy(), 3, axis=-1)
        return cls(**named, start=start, end=end, by=by)


_NUMBERS: dict[str, Callable[[float], Any]] = {
    "phase": lambda value: Phase(round(value)),
    "operation": round,
    "move": round,
    "clock": float,
    "rate": float,
    "rest": float,
    "waited": float,
    "duration": float,
    "fault": lambda value: Fault(round(value)),
    "where": round,
    "limb": round,
    "locked": round,
    "broken_off": lambda value: Phase(round(value)),
}


# Requested poses count from here on [m, rad].
_ASKED = 5e-4
# Poses at which a lift is looked at before it begins, between two ticks of a controller.
_LOOKS_OF_LIFT = 8


def _swinging(progress: Progress, phase: Phase, lock_set: LockSet) -> Progress:
    """A progress in which a limb is to be swung, with its locks."""
    places = [
        (limb - 1) * LOCKS_OF_LIMB + LOCKABLE.index(joint) for limb, joint in lock_set.joints
    ]
    locked = sum(1 << place for place in places)
    return replace(progress, phase=phase, limb=lock_set.limb, locked=locked)


# Number of the motion that takes the drill out of a hole.
_LAST_MOVE = 3


class Motion(NamedTuple):
    """Motion of platform or foot.

    Attributes:
        end: (6) pose at its end [m, rad].
        duration: [s].
    """

    end: Array
    duration: float


class Sequence:
    """A job, and what it does at an instant."""

    def __init__(self, geometry: CentreGeometry, job: Job, period: float, params: SequenceParams):
        """Takes a job.

        Args:
            geometry: the centre.
            job: the job.
            period: between two instants [s].
            params: times and tolerances.
        """
        self.geometry, self.job, self.period, self.params = geometry, job, period, params
        self._ways: dict[int, CubicSpline] = {}

    def operation(self, progress: Progress) -> Operation | None:
        """The operation that is due; None after the last one."""
        number = progress.operation
        return self.job.operations[number] if number < len(self.job.operations) else None

    def loose(self, progress: Progress) -> int:
        """The limb whose clamp is to be open, from 1; 0: none."""
        return progress.limb if progress.rule.is_loose else 0

    def locks(self, progress: Progress) -> NDArray[np.bool_]:
        """(n, 4) locks that are to be closed."""
        count = self.geometry.limbs * LOCKS_OF_LIMB
        mask = progress.locked if progress.rule.locks else 0
        closed = np.array([bool(mask >> bit & 1) for bit in range(count)])
        return closed.reshape(-1, LOCKS_OF_LIMB)

    def clamps(self, progress: Progress) -> NDArray[np.bool_]:
        """(n) clamps that are to be closed."""
        closed = np.ones(self.geometry.limbs, dtype=bool)
        if loose := self.loose(progress):
            closed[loose - 1] = False
        return closed

    def _set_off(self, progress: Progress) -> Progress:
        """A progress whose phase or motion begins."""
        motion = self._motion(progress)
        if motion is None:
            return replace(progress, duration=0.0)
        by = displacement(progress.start, motion.end)
        return replace(progress, duration=motion.duration, end=motion.end, by=by)

    def _motion(self, progress: Progress) -> Motion | None:
        """The motion from where a progress starts; None where nothing moves."""
        operation, phase = self.operation(progress), progress.phase
        speeds = self.job.speeds
        if isinstance(operation, Drill) and phase in (Phase.MACHINING, Phase.RETRACTION):
            moves = drilling(self.job, operation)
            end, speed = moves[-1 if phase is Phase.RETRACTION else progress.move]
            return Motion(end, duration_of(progress.start, end, speeds, speed))
        if isinstance(operation, Swing) and phase is Phase.RECONFIGURATION:
            end = operation.pose
            return Motion(end, duration_of(progress.start, end, speeds, speeds.rapid))
        if phase is Phase.SWING and not isinstance(operation, Drill):
            end, lift = self._foothold(operation, progress.start), self._lift(progress)
            return Motion(end, swing_duration(progress.start, end, lift, speeds))
        return None

    def _foothold(self, swing: Swing | None, foot: Array) -> Array:
        """Foothold (6) of a swing; a foot that may turn keeps its heading."""
        if swing is not None and not turns(self.geometry):
            return swing.foothold
        panel = self.job.panel
        along, across, _ = panel.place(foot[:3] if swing is None else swing.foothold[:3])
        return panel.foothold(float(along), float(across), panel.heading(foot))

    def toward(self, progress: Progress, ahead: float) -> Array:
        """Pose (6) of the platform to which it goes, as far as foot and locks leave it open."""
        operation = self.operation(progress)
        if not isinstance(operation, Swing) or operation.way is None:
            return np.full(6, np.nan)
        if progress.operation not in self._ways:
            shares = np.linspace(0.0, 1.0, len(operation.way))
            self._ways[progress.operation] = CubicSpline(shares, operation.way)
        share = self.share(progress, ahead) if progress.move == 0 else 1.0
        return np.asarray(self._ways[progress.operation](values_of(share)))

    def _lift(self, progress: Progress) -> float:
        """Height of a foot's motion: none of the last one, by which it comes to its place [m]."""
        return self.job.lift if progress.move == 0 else 0.0

    def share(self, progress: Progress, ahead: float) -> Elementwise:
        """Share of the motion that has passed some time ahead [s]."""
        if progress.duration == 0.0:
            return 0.0
        return least(1.0, (progress.clock + progress.rate * ahead) / progress.duration)

    def at(self, progress: Progress, ahead: float) -> Array:
        """Pose (6) of what moves, some time ahead [s]."""
        start, end, by = progress.start, progress.end, progress.by
        if progress.duration == 0.0:
            return start
        share = self.share(progress, ahead)
        if progress.rule.moves == "foot":
            return foot_at(start, end, by, self._lift(progress), share)
        return platform_at(start, by, share)

    def advanced(self, progress: Progress, observed: Seen) -> Progress:
        """The progress a period later.

        Args:
            progress: now.
            observed: measurements of this instant.
        """
        if progress.phase is Phase.FAULT:
            return progress
        fault, where = self._fault(progress, observed)
        if fault:
            return progress.failed(fault, where)
        if observed.is_stopped and (stopped := self._stopped(progress, observed)) is not None:
            return stopped
        if progress.clock < progress.duration:
            rate = least(1.0, progress.rate + self.period / self.params.stopping)
            clock = progress.clock + progress.rate * self.period
            return replace(progress, clock=clock, rate=rate, rest=0.0, waited=0.0)
        return self._rested(progress, observed)

    def _rested(self, progress: Progress, observed: Seen) -> Progress:
        """Waits until legs and switches are as they should be; then goes on."""
        is_right = answer_of(
            (observed.locks == self.locks(progress)).all(axis=(-2, -1))
            & (observed.clamps == self.clamps(progress)).all(axis=-1)
            & (np.abs(observed.error).max(axis=-1) <= self.params.tolerance)
        )
        rest = where(is_right, progress.rest + self.period, 0.0)
        resting = replace(progress, rest=rest, waited=progress.waited + self.period)
        settling = self.params.settling
        if progress.phase is Phase.MACHINING and progress.move < _LAST_MOVE:
            settling = 0.0  # from one motion to the next
        if either(negated(is_right), rest < settling - 1e-9):
            return resting
        return self._next(resting, observed)

    def _next(self, progress: Progress, observed: Seen) -> Progress:
        """The phase or motion after one that is over."""
        phase, follows = progress.phase, RULES[progress.phase].follows
        if phase is Phase.WAITING and observed.time < self.params.begin:
            return progress
        if follows is None and phase is not Phase.SETTLED:
            return progress
        _insist_on_one(observed)
        restarted = replace(
            progress, clock=0.0, rate=1.0, rest=0.0, waited=0.0, start=observed.pose
        )
        if phase is Phase.MACHINING and progress.move < _LAST_MOVE:
            return self._set_off(replace(restarted, move=progress.move + 1))
        if phase is Phase.SWING and progress.move == 0:
            foot = observed.feet[progress.limb - 1]
            return self._set_off(replace(restarted, move=1, start=foot))
        if follows is None:
            return self._begun(restarted, observed)
        if follows is Phase.UNLOCK:
            restarted = replace(restarted, move=_LAST_MOVE)
        elif progress.move == _LAST_MOVE:
            number = progress.operation + (self.operation(progress) is not None)
            restarted = replace(restarted, operation=number, move=0, limb=0, locked=0)
        if follows is Phase.LOCK and progress.limb == 0:
            follows = Phase.SETTLED  # a person has moved the platform
        if follows is Phase.LOCK and np.abs(observed.load).max() > self.params.largest_load:
            return progress.failed(Fault.UNDER_LOAD)
        if follows is Phase.SWING:
            restarted = replace(restarted, start=observed.feet[progress.limb - 1])
        if observed.is_stopped and follows is Phase.SETTLED:
            follows = Phase.STOPPED
        return self._set_off(replace(restarted, phase=follows))

    def _begun(self, progress: Progress, observed: Seen) -> Progress:
        """The next operation, unless its pose does not carry it."""
        operation = self.operation(progress)
        if operation is None and observed.asked is None:
            return replace(progress, phase=Phase.DONE)
        if operation is None:
            return self._asked(progress, observed)
        if isinstance(operation, Swing):
            return self._set_off(_swinging(progress, Phase.RECONFIGURATION, operation.lock_set))
        try:
            check_drill(self.geometry, self.job, operation, observed.feet)
        except Refused:
            return progress.failed(Fault.REFUSED, progress.operation + 1)
        return self._set_off(replace(progress, phase=Phase.MACHINING))

    def _asked(self, progress: Progress, observed: Seen) -> Progress:
        """Goes where a person asks the platform to, or lifts a foot and puts it down again."""
        assert observed.asked is not None
        pose, limb = observed.asked[:6], round(float(observed.asked[6]))
        if 1 <= limb <= self.geometry.limbs:
            least = self.job.least_sigma
            sets = best_sets(self.geometry, observed.pose, observed.feet, limb, least, 1)
            if not sets or not self._may_lift(sets[0], observed):
                return progress
            return _swinging(progress, Phase.LOCK, sets[0])
        by = displacement(observed.pose, pose)
        looks = np.array([platform_at(observed.pose, by, share) for share in (0.5, 1.0)])
        lengths = leg_lengths(self.geometry, looks, observed.feet)
        is_possible = within_stroke(self.geometry, lengths).all() and is_clear(self.job, looks)
        if np.abs(by).max() < _ASKED or not is_possible:
            return progress
        speeds = self.job.speeds
        duration = duration_of(observed.pose, pose, speeds, speeds.rapid)
        phase = Phase.RECONFIGURATION
        return replace(progress, phase=phase, duration=duration, end=pose, by=by)

    def _may_lift(self, lock_set: LockSet, observed: Seen) -> bool:
        """True if a foot can be lifted and put down with the drill clear of the panel."""
        foothold = self._foothold(None, observed.feet[lock_set.limb - 1])
        swing = Swing(observed.pose, lock_set, foothold)
        try:
            try_swing(self.geometry, self.job, swing, observed.feet, _LOOKS_OF_LIFT)
        except Refused:
            return False
        return True

    def _stopped(self, progress: Progress, observed: Seen) -> Progress | None:
        """The progress of a job that is stopped; None where the phase goes on as it does."""
        _insist_on_one(observed)
        phase, rest = (
            progress.phase,
            replace(progress, clock=0.0, rate=1.0, rest=0.0, waited=0.0, start=observed.pose),
        )
        if phase in (Phase.WAITING, Phase.SETTLED):
            return self._set_off(replace(rest, phase=Phase.STOPPED))
        if phase is Phase.LOCK:
            return self._set_off(replace(rest, phase=Phase.UNLOCK))
        if phase not in (Phase.MACHINING, Phase.RECONFIGURATION):
            return None  # a loose foot comes to its foothold first
        rate = progress.rate - self.period / self.params.stopping
        if rate > 0.0:
            clock = progress.clock + progress.rate * self.period
            return replace(progress, clock=clock, rate=rate)
        follows = Phase.RETRACTION if phase is Phase.MACHINING else Phase.STOPPED
        return self._set_off(replace(rest, phase=follows))

    def _fault(self, progress: Progress, observed: Seen) -> tuple[Fault, int]:
        """Fault of an instant, and limb, leg or operation that it is about."""
        rule, limb = RULES[progress.phase], progress.limb
        if observed.is_pressed:
            return Fault.EMERGENCY_STOP, 0
        locks = np.argwhere(common(observed.locks != self.locks(progress), 2))
        clamps = np.flatnonzero(common(observed.clamps != self.clamps(progress))) + 1
        if rule.switches == "clamp":
            others = [other for other in clamps.tolist() if other != limb]
        else:
            others = clamps.tolist()
        if others:
            return Fault.CLAMP_LOST, others[0]
        if len(locks) and rule.switches != "locks":
            return Fault.LOCK_LOST, int(locks[0, 0]) + 1
        if observed.is_stuck:
            return Fault.NO_WAY, progress.operation + 1
        is_known = np.isfinite(observed.feet).all(axis=(-2, -1))
        is_known = is_known & np.isfinite(observed.pose).all(axis=-1)
        if not (observed.is_determined and answer_of(is_known)):
            return Fault.NOT_DETERMINED, 0
        error = np.abs(observed.error)
        late = progress.waited > self.params.switching
        allowed = where(late, self.params.tolerance, self.params.largest_error)
        if not answer_of(error.max(axis=-1) <= values_of(allowed)):
            _insist_on_one(observed)
            return Fault.OFF_COURSE, int(np.nan_to_num(error, nan=np.inf).argmax()) + 1
        if (len(locks) or len(clamps)) and late:
            return Fault.SWITCH_LATE, int(clamps[0] if len(clamps) else locks[0, 0] + 1)
        return Fault.NONE, 0


def _insist_on_one(observed: Seen) -> None:
    """Has what happens rarely looked at one row at a time.

    Raises:
        TypeError: there are several rows.
    """
    if observed.pose.ndim > 1:
        raise TypeError("rows are taken one at a time")


def expected_duration(
    geometry: CentreGeometry, job: Job, beginning: Posture, params: SequenceParams
) -> float:
    """Duration of a job in which nothing goes wrong, but for what locks and clamps take [s].

    Args:
        geometry: the centre.
        job: the job.
        beginning: platform and feet before.
        params: times and tolerances.
    """
    speeds, rests = job.speeds, 1
    total, (pose, feet) = params.begin, beginning
    feet = feet.copy()
    for operation in job.operations:
        if isinstance(operation, Drill):
            moves = drilling(job, operation)
            rests += 2
        else:
            moves = ((operation.pose, speeds.rapid),)
            foot = feet[operation.lock_set.limb - 1]
            total += swing_duration(foot, operation.foothold, job.lift, speeds)
            foot[:] = operation.foothold
            rests += 8
        for end, speed in moves:
            total += duration_of(pose, end, speeds, speed)
            pose = end
        if isinstance(operation, Swing) and operation.way is not None:
            pose = operation.way[-1]
    return total + rests * params.settling


def drilling(job: Job, drill: Drill) -> tuple[tuple[Array, float], ...]:
    """Poses of the platform for a hole, and the speeds to them; the last one retracts."""
    process, speeds = job.process, job.speeds
    above = drill.pose(process, process.clearance)
    near = drill.pose(process, min(1e-3, process.clearance))
    deep = drill.pose(process, -drill.depth)
    return (above, speeds.rapid), (near, speeds.rapid), (deep, speeds.feed), (above, speeds.rapid)
