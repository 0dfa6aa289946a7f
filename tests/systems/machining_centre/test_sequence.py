"""Sequences of jobs on an ideal plant: legs are where they are led, switches follow later."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.job import (
    Drill,
    Job,
    Process,
    Swing,
    check_job,
    row_of_holes,
    standing,
)
from parapod.systems.machining_centre.panel import Panel
from parapod.systems.machining_centre.paths import Speeds
from parapod.systems.machining_centre.sequence import (
    RULES,
    Fault,
    Phase,
    Progress,
    Seen,
    Sequence,
    SequenceParams,
    expected_duration,
    words_of,
)
from parapod.systems.machining_centre.sequencer import CentreSequencer
from parapod.systems.machining_centre.swing import LockSet
from parapod.systems.machining_centre.walk import plan_walk

PERIOD = 0.04
PARAMS = SequenceParams(begin=0.2)
ENDED = (Phase.DONE, Phase.STOPPED, Phase.FAULT)
LIMBS = pytest.mark.parametrize("limbs", [3, 4], ids=["tripod", "quadruped"])
FASTER = Speeds(rapid=0.1, turn=0.4, feed=0.004, swing=0.1, acceleration=0.4, leg=0.3)


@cache
def job_of(limbs):
    """A hole, a step of all feet, and a hole there; beginning and end."""
    geometry, blank = CentreGeometry(limbs), Job(panel=Panel(3.0), speeds=FASTER)
    beginning = standing(geometry, blank.panel, 0.52)
    first = row_of_holes(blank.panel, (0.0, 0.0), 0.5, 1, 0.03, tilt=0.1, depth=0.004)
    before = check_job(geometry, replace(blank, operations=first), beginning)
    walk = plan_walk(geometry, blank, before, (0.03, 0.01), 1, 0.52)
    second = row_of_holes(blank.panel, (0.03, 0.01), 0.5, 1, 0.03, tilt=0.1, depth=0.004)
    job = replace(blank, operations=(*first, *walk, *second))
    return geometry, job, beginning, check_job(geometry, job, beginning)


class Plant:
    """Platform and feet that are exactly where a sequence has them, and switches that are late."""

    def __init__(self, sequence, beginning, delay=2):
        self.sequence, self.delay, self.now = sequence, delay, 0
        self.pose, self.feet = beginning.pose, beginning.feet.copy()
        n = len(self.feet)
        self.locks, self.clamps = np.zeros((n, 4), dtype=bool), np.ones(n, dtype=bool)
        self.asked = []

    def copy(self):
        other = object.__new__(Plant)
        other.__dict__ = self.__dict__ | {"feet": self.feet.copy(), "asked": [*self.asked]}
        return other

    def seen(self, progress, **changes):
        """Goes to the instant of a progress; observations there."""
        sequence = self.sequence
        if progress.phase is not Phase.FAULT and progress.duration > 0.0:
            at = sequence.at(progress, 0.0)
            if progress.rule.moves == "platform":
                self.pose = at
            else:
                self.feet[progress.limb - 1] = at
                toward = sequence.toward(progress, 0.0)
                self.pose = toward if np.isfinite(toward).all() else self.pose
        self.asked.append((sequence.locks(progress), sequence.clamps(progress)))
        if len(self.asked) > self.delay:
            self.locks, self.clamps = self.asked[-1 - self.delay]
        seen = Seen(
            time=self.now * PERIOD,
            locks=self.locks,
            clamps=self.clamps,
            feet=self.feet.copy(),
            pose=self.pose,
            error=np.zeros(2 * len(self.feet)),
            load=np.zeros(2),
        )
        self.now += 1
        return seen._replace(**changes)


class Course:
    """Every instant of a job: progress, plant, and what was seen."""

    def __init__(self, limbs, delay=2):
        self.geometry, self.job, self.beginning, self.end = job_of(limbs)
        self.sequence = Sequence(self.geometry, self.job, PERIOD, PARAMS)
        self.plant = Plant(self.sequence, self.beginning, delay)
        self.progresses, self.plants, self.seen = [], [], []
        self.go_on(Progress())

    def go_on(self, progress, most=4000, rest=8, **changes):
        """Runs to the end from a progress, and a little longer."""
        left = rest
        for _ in range(most):
            self.plants.append(self.plant.copy())
            self.progresses.append(progress)
            seen = self.plant.seen(progress, **changes)
            self.seen.append(seen)
            progress = self.sequence.advanced(progress, seen)
            left = left - 1 if self.progresses[-1].phase in ENDED else rest
            if left == 0:
                return self
        raise AssertionError(f"no end: {progress}")

    def branch(self, instant):
        """The same course up to an instant, which another one may follow."""
        other = object.__new__(Course)
        other.__dict__ = dict(self.__dict__)
        other.plant = self.plants[instant].copy()
        for name in ("progresses", "plants", "seen"):
            setattr(other, name, getattr(self, name)[:instant])
        return other

    @property
    def last(self):
        return self.progresses[-1]

    @property
    def phases(self):
        found = [self.progresses[0].phase]
        for progress in self.progresses:
            if progress.phase is not found[-1]:
                found.append(progress.phase)
        return found

    def first(self, phase, **attributes):
        """First instant in a phase."""
        for k, progress in enumerate(self.progresses):
            if progress.phase is phase and all(
                getattr(progress, name) == value for name, value in attributes.items()
            ):
                return k
        raise AssertionError(f"{phase.name} is never reached")

    def middle(self, phase, **attributes):
        """An instant amid a phase's first visit."""
        start = self.first(phase, **attributes)
        end = start
        while self.progresses[end + 1].phase is phase:
            end += 1
        return (start + end) // 2

    def commands(self, progress):
        return np.concatenate(
            (self.sequence.locks(progress).ravel(), self.sequence.clamps(progress))
        )


@pytest.fixture(scope="module")
def courses():
    return {limbs: Course(limbs) for limbs in (3, 4)}


def tip_height(course, seen):
    return float(course.job.panel.place(course.job.process.tip(seen.pose))[2])


def check_switching(course):
    """Switches are commanded at rest and with the tool out; never are two feet loose."""
    progresses, seen = course.progresses, course.seen
    for k in range(1, len(progresses)):
        before, after = (course.commands(each) for each in progresses[k - 1 : k + 1])
        switched = np.flatnonzero(before != after)
        loose = np.flatnonzero(~course.sequence.clamps(progresses[k]))
        assert len(loose) <= 1
        if not len(switched):
            continue
        clamps = switched >= course.geometry.limbs * 4
        assert clamps.all() or not clamps.any()
        assert clamps.sum() <= 1
        near = range(max(0, k - 3), min(k + 2, len(seen)))
        for other in near:
            assert np.array_equal(seen[other].pose, seen[k].pose)
            assert np.array_equal(seen[other].feet, seen[k].feet)
        assert tip_height(course, seen[k]) > 0.4 * course.job.process.clearance


@LIMBS
def test_a_whole_job_ends_where_its_plan_does(courses, limbs):
    course = courses[limbs]
    assert course.last.phase is Phase.DONE
    assert course.last.operation == len(course.job.operations)
    seen = course.seen[-1]
    assert np.allclose(seen.pose, course.end.pose, atol=1e-12)
    assert np.allclose(seen.feet[:, :3], course.end.feet[:, :3], atol=1e-12)
    assert not seen.locks.any()
    assert seen.clamps.all()


@LIMBS
def test_phases_follow_each_other_as_the_table_has_them(courses, limbs):
    course = courses[limbs]
    drilling = [Phase.MACHINING]
    swing = [Phase.RECONFIGURATION, Phase.LOCK, Phase.UNCLAMP, Phase.SWING, Phase.CLAMP]
    expected = [Phase.WAITING]
    for operation in course.job.operations:
        expected += [Phase.SETTLED]
        expected += drilling if isinstance(operation, Drill) else [*swing, Phase.UNLOCK]
    assert course.phases == [*expected, Phase.SETTLED, Phase.DONE]


def test_every_phase_of_the_table_is_reached(courses):
    course = courses[3]
    stopped = course.branch(course.first(Phase.MACHINING, move=2) + 3)
    stopped.go_on(course.progresses[len(stopped.progresses)], is_stopped=True)
    pressed = course.branch(5)
    pressed.go_on(course.progresses[5], is_pressed=True)
    assert {*course.phases, *stopped.phases, *pressed.phases} == set(RULES) == set(Phase)


@LIMBS
def test_locks_and_clamps_are_switched_at_rest_with_the_tool_out(courses, limbs):
    check_switching(courses[limbs])


@LIMBS
def test_nothing_moves_until_locks_and_clamps_tell_what_they_are_to_be(courses, limbs):
    course = courses[limbs]
    for k, (progress, seen) in enumerate(zip(course.progresses, course.seen, strict=True)):
        if not np.array_equal(seen.pose, course.seen[max(k - 1, 0)].pose):
            assert np.array_equal(seen.locks, course.sequence.locks(progress))
            assert np.array_equal(seen.clamps, course.sequence.clamps(progress))


@LIMBS
def test_platform_and_feet_are_led_without_a_jump(courses, limbs):
    course = courses[limbs]
    # A platform that is led by the way of a swing may be a little faster than the foot.
    fastest = {"pose": 1.5 * FASTER.rapid, "feet": 1.05 * FASTER.swing}
    for name, speed in fastest.items():
        ways = np.array([np.reshape(getattr(seen, name), (-1, 6)) for seen in course.seen])
        steps = np.linalg.norm(np.diff(ways[..., :3], axis=0), axis=-1)
        assert 0.5 * speed * PERIOD < steps.max() <= speed * PERIOD


@LIMBS
def test_what_is_told_a_period_ahead_is_what_is_then(courses, limbs):
    course = courses[limbs]
    stopped = course.branch(course.middle(Phase.RECONFIGURATION))
    stopped.go_on(course.progresses[len(stopped.progresses)], is_stopped=True)
    moving, slower = 0, 0
    for each in (course, stopped):
        sequence, told = each.sequence, zip(each.progresses, each.progresses[1:], strict=False)
        for now, then in told:
            if 0.0 < now.clock < then.clock:
                moving, slower = moving + 1, slower + (now.rate < 1.0)
                ahead = sequence.at(now, PERIOD)
                assert np.allclose(ahead, sequence.at(then, 0.0), atol=1e-14)
                toward = sequence.toward(now, PERIOD), sequence.toward(then, 0.0)
                assert np.allclose(*toward, atol=1e-12, equal_nan=True)
    assert moving > 100
    assert slower > 3


@LIMBS
def test_a_foot_is_loose_only_with_all_locks_of_its_limb_closed(courses, limbs):
    course = courses[limbs]
    loosened = set()
    for progress, seen in zip(course.progresses, course.seen, strict=True):
        for limb in np.flatnonzero(~seen.clamps) + 1:
            operation = course.sequence.operation(progress)
            loosened.add((progress.operation, limb))
            assert isinstance(operation, Swing)
            assert operation.lock_set.limb == limb
            assert seen.locks[limb - 1].all()
            assert seen.locks.sum() == len(operation.lock_set.joints)
    assert [limb for _, limb in sorted(loosened)] == [
        operation.lock_set.limb
        for operation in course.job.operations
        if isinstance(operation, Swing)
    ]


@LIMBS
def test_switches_are_waited_for_however_late_they_are(courses, limbs):
    course, later = courses[limbs], Course(limbs, delay=20)
    assert later.last.phase is Phase.DONE
    assert later.phases == course.phases
    swings = sum(isinstance(operation, Swing) for operation in course.job.operations)
    more = len(later.progresses) - len(course.progresses)
    assert more == pytest.approx(4 * swings * (20 - 2), abs=4 * swings)
    check_switching(later)


@LIMBS
def test_a_job_takes_as_long_as_it_is_expected_to(courses, limbs):
    course = courses[limbs]
    expected = expected_duration(course.geometry, course.job, course.beginning, PARAMS)
    took = PERIOD * course.first(Phase.DONE)
    # Rests and motions last whole periods.
    assert expected < took < 1.25 * expected + 1.0


@LIMBS
def test_holes_are_drilled_to_their_depth_along_their_axes(courses, limbs):
    course = courses[limbs]
    for number, operation in enumerate(course.job.operations):
        if not isinstance(operation, Drill):
            continue
        poses = [
            seen.pose
            for progress, seen in zip(course.progresses, course.seen, strict=True)
            if progress.phase is Phase.MACHINING
            and progress.operation == number
            and progress.move >= 1
        ]
        tips = course.job.process.tip(np.array(poses)) - operation.hole[:3]
        turned = np.array([operation.pose(course.job.process, h)[:3] for h in (1.0, 0.0)])
        axis = turned[0] - turned[1]
        depth = tips @ axis
        assert np.allclose(tips, depth[:, None] * axis, atol=1e-12)
        assert depth.min() == pytest.approx(-operation.depth, abs=1e-12)
        assert depth[-1] == pytest.approx(course.job.process.clearance, abs=1e-12)


@LIMBS
def test_a_stop_at_any_instant_ends_at_rest_clamped_unlocked_and_retracted(courses, limbs):
    course = courses[limbs]
    ends = set()
    for instant in np.linspace(1, course.first(Phase.DONE) - 1, 40).astype(int):
        stopped = course.branch(instant)
        begun = course.progresses[instant]
        stopped.go_on(begun, is_stopped=True)
        assert stopped.last.phase is Phase.STOPPED, begun.phase
        seen = stopped.seen[-1]
        assert seen.clamps.all()
        assert not seen.locks.any()
        assert stopped.commands(stopped.last).sum() == limbs
        assert tip_height(stopped, seen) > 0.4 * stopped.job.process.clearance
        # Nothing new is begun.
        assert {each.operation for each in stopped.progresses[instant:]} <= {
            begun.operation,
            begun.operation + 1,
        }
        # An operation counts once what it is about is done: the foot stands, the tool is out.
        done = begun.operation
        last_move = begun.phase in (Phase.MACHINING, Phase.RETRACTION) and begun.move == 3
        if last_move or begun.phase in (Phase.UNCLAMP, Phase.SWING, Phase.CLAMP, Phase.UNLOCK):
            done += 1
        assert stopped.last.operation == done, begun
        check_switching(stopped)
        ends.add(begun.phase)
    assert {Phase.MACHINING, Phase.RECONFIGURATION, Phase.SWING} <= ends


@pytest.mark.parametrize("phase", [Phase.LOCK, Phase.UNCLAMP, Phase.CLAMP, Phase.UNLOCK])
def test_a_stop_while_locks_or_clamps_switch_ends_whole_too(courses, phase):
    course = courses[3]
    for instant in range(course.first(phase), course.first(phase) + 5):
        stopped = course.branch(instant)
        begun = course.progresses[instant]
        stopped.go_on(begun, is_stopped=True)
        assert stopped.last.phase is Phase.STOPPED
        assert stopped.last.operation == begun.operation + (begun.phase is not Phase.LOCK)
        assert stopped.seen[-1].clamps.all()
        assert not stopped.seen[-1].locks.any()
        check_switching(stopped)


def test_a_stop_slows_a_motion_down_and_goes_nowhere_else(courses):
    course = courses[3]
    instant = course.middle(Phase.RECONFIGURATION)
    stopped = course.branch(instant)
    stopped.go_on(course.progresses[instant], is_stopped=True)
    poses = np.array([seen.pose[:3] for seen in stopped.seen[instant - 3 :]])
    speeds = np.linalg.norm(np.diff(poses, axis=0), axis=1) / PERIOD
    assert speeds[0] > 1e-3
    assert (np.diff(speeds) < 1e-3).all()
    assert speeds[round(PARAMS.stopping / PERIOD) + 5 :].max() == 0.0
    # Never back, but for the last period's part of what the speed still was.
    assert np.linalg.norm(poses[-1] - poses[0]) >= np.linalg.norm(poses[2] - poses[0])


def test_a_stop_that_is_taken_back_lets_the_job_go_on(courses):
    course = courses[3]
    instant = course.middle(Phase.RECONFIGURATION)
    progress, sequence = course.progresses[instant], course.sequence
    other = course.branch(instant)
    for _ in range(3):
        progress = sequence.advanced(progress, other.plant.seen(progress, is_stopped=True))
    assert 0.0 < progress.rate < 1.0
    other.go_on(progress)
    assert other.last.phase is Phase.DONE


def hurt(seen, changes):
    return seen._replace(
        **{name: change(getattr(seen, name).copy()) for name, change in changes.items()}
    )


def without(index):
    def change(array):
        array[index] = ~array[index] if array.dtype == bool else array[index] + 1.0
        return array

    return change


MOVING_OR_CLAMPING = (
    *(Phase.MACHINING, Phase.RECONFIGURATION, Phase.UNCLAMP, Phase.SWING, Phase.CLAMP),
    Phase.SETTLED,
)
# Cause, phases in which it counts, fault, and where.
CAUSES = {
    "a clamp of a limb that stands opens": (
        {"clamps": without(1)},
        [phase for phase in Phase if phase < Phase.RETRACTION],
        Fault.CLAMP_LOST,
        2,
    ),
    "the loose foot's clamp closes": (
        {"clamps": without(0)},
        (Phase.SWING, Phase.MACHINING, Phase.LOCK, Phase.UNLOCK),
        Fault.CLAMP_LOST,
        1,
    ),
    "a lock opens or closes": (
        {"locks": without((2, 0))},
        MOVING_OR_CLAMPING,
        Fault.LOCK_LOST,
        3,
    ),
    "a leg is off course": (
        {"error": without(4)},
        (Phase.MACHINING, Phase.SWING, Phase.LOCK, Phase.SETTLED),
        Fault.OFF_COURSE,
        5,
    ),
    "a length is no number": (
        {"error": lambda error: np.where(np.arange(len(error)) == 3, np.nan, error)},
        (Phase.MACHINING, Phase.SWING, Phase.SETTLED),
        Fault.OFF_COURSE,
        4,
    ),
}


@pytest.mark.parametrize(("changes", "phases", "fault", "where"), CAUSES.values(), ids=CAUSES)
def test_each_cause_ends_the_job_in_its_fault_with_everything_held(
    courses, changes, phases, fault, where
):
    course = courses[3]
    for phase in phases:
        instant = course.middle(phase)
        if phase is Phase.SWING:
            assert course.progresses[instant].limb == 1
        progress = course.progresses[instant]
        failed = course.sequence.advanced(progress, hurt(course.seen[instant], changes))
        assert (failed.phase, failed.fault, failed.where) == (Phase.FAULT, fault, where), phase
        assert failed.broken_off is phase
        check_held(course, progress, failed)


def check_held(course, progress, failed):
    """Nothing is switched or moved any more, whatever comes."""
    assert np.array_equal(course.commands(failed), course.commands(progress))
    assert course.sequence.loose(failed) == course.sequence.loose(progress)
    for seen in (course.seen[0], course.seen[-1]._replace(is_stopped=True)):
        assert course.sequence.advanced(failed, seen) is failed
    system = CentreSequencer(course.geometry, course.job, PERIOD, PARAMS)
    context = system.CreateDefaultContext()
    context.SetDiscreteState(failed.numbers())
    shown = {name: system.GetOutputPort(name).Eval(context) for name in ("mode", "brake", "done")}
    assert {name: float(value[0]) for name, value in shown.items()} == {
        "mode": 0.0,
        "brake": 1.0,
        "done": 1.0,
    }
    commands = [
        system.GetOutputPort(f"{part}_command").Eval(context) for part in ("locks", "clamps")
    ]
    assert np.array_equal(np.concatenate(commands) > 0.5, course.commands(progress))


ANYWHERE = {
    "emergency stop": ({"is_pressed": True}, Fault.EMERGENCY_STOP, lambda progress: 0),
    "not determined": ({"is_determined": False}, Fault.NOT_DETERMINED, lambda progress: 0),
    "no way": ({"is_stuck": True}, Fault.NO_WAY, lambda progress: progress.operation + 1),
}


@pytest.mark.parametrize(("changes", "fault", "where"), ANYWHERE.values(), ids=ANYWHERE)
@pytest.mark.parametrize("phase", [phase for phase in Phase if phase < Phase.SETTLED])
def test_some_causes_end_the_job_in_any_phase(courses, phase, changes, fault, where):
    course = courses[3]
    instant = course.middle(phase)
    progress = course.progresses[instant]
    failed = course.sequence.advanced(progress, course.seen[instant]._replace(**changes))
    assert (failed.phase, failed.fault) == (Phase.FAULT, fault)
    assert failed.where == where(progress)
    check_held(course, progress, failed)


@pytest.mark.parametrize(
    ("phase", "name"), [(Phase.LOCK, "locks"), (Phase.UNCLAMP, "clamps"), (Phase.CLAMP, "clamps")]
)
def test_what_does_not_switch_in_time_ends_the_job(courses, phase, name):
    course = courses[3]
    instant = course.first(phase)
    late = course.branch(instant)
    stuck = getattr(course.seen[instant - 1], name)
    late.go_on(course.progresses[instant], **{name: stuck})
    assert late.last.fault is Fault.SWITCH_LATE
    assert late.last.broken_off is phase
    assert late.last.where == (1 if name == "clamps" else late.last.where)
    waited = PERIOD * (late.first(Phase.FAULT) - instant)
    assert waited == pytest.approx(PARAMS.switching, abs=3 * PERIOD)


def test_legs_that_do_not_come_to_rest_end_the_job_though_they_are_not_far_off(courses):
    course = courses[3]
    instant = course.first(Phase.CLAMP)
    error = np.where(np.arange(6) == 2, -2.0 * PARAMS.tolerance, 0.0)
    late = course.branch(instant)
    late.go_on(course.progresses[instant], error=error)
    assert (late.last.fault, late.last.where) == (Fault.OFF_COURSE, 3)
    assert PERIOD * (late.first(Phase.FAULT) - instant) > PARAMS.switching


def test_nothing_is_locked_while_the_drill_carries_load(courses):
    course = courses[3]
    for load in ((1.1 * PARAMS.largest_load, 0.0), (0.0, -1.1 * PARAMS.largest_load)):
        instant = course.first(Phase.RECONFIGURATION)
        loaded = course.branch(instant)
        loaded.go_on(course.progresses[instant], load=np.array(load))
        assert loaded.last.fault is Fault.UNDER_LOAD
        assert not any(loaded.sequence.locks(each).any() for each in loaded.progresses)
    free = course.branch(instant)
    free.go_on(course.progresses[instant], load=np.full(2, 0.9 * PARAMS.largest_load))
    assert free.last.phase is Phase.DONE


def test_a_hole_that_is_too_hard_from_these_feet_is_not_begun(courses):
    course = courses[3]
    hard = Process(thrust=2000.0)
    sequence = Sequence(course.geometry, replace(course.job, process=hard), PERIOD, PARAMS)
    instant = course.first(Phase.MACHINING) - 1
    failed = sequence.advanced(course.progresses[instant], course.seen[instant])
    assert (failed.fault, failed.where) == (Fault.REFUSED, 1)
    assert "operation 1 asks for more" in words_of(failed.fault, failed.where)


def test_a_posture_that_is_no_number_ends_the_job_by_a_fault(courses):
    course = courses[3]
    for k in range(course.first(Phase.RECONFIGURATION, operation=2)):
        for name in ("pose", "feet"):
            lost = course.seen[k]._replace(**{name: getattr(course.seen[k], name) * np.nan})
            failed = course.sequence.advanced(course.progresses[k], lost)
            assert failed.fault is Fault.NOT_DETERMINED, (k, name)


def test_every_fault_has_words_and_none_comes_by_itself(courses):
    for fault in Fault:
        assert "{" not in words_of(fault, 7)
    for course in courses.values():
        assert {progress.fault for progress in course.progresses} == {Fault.NONE}


def test_a_job_without_operations_is_done_at_once_after_its_beginning():
    geometry, *_ = job_of(3)
    sequence = Sequence(geometry, Job(), PERIOD, PARAMS)
    plant, progress = Plant(sequence, standing(geometry, Panel(3.0), 0.52)), Progress()
    for _ in range(20):
        progress = sequence.advanced(progress, plant.seen(progress))
        if PERIOD * plant.now <= PARAMS.begin:
            assert progress.phase is Phase.WAITING
    assert progress.phase is Phase.DONE


def test_a_progress_is_that_of_its_numbers():
    rng = np.random.default_rng(0)
    for _ in range(50):
        whole = rng.integers(0, 50, 5).tolist()
        clock, rate, rest, waited, duration = rng.uniform(0.0, 20.0, 5).tolist()
        start, end, by = rng.normal(size=(3, 6))
        progress = Progress(
            *(Phase(int(rng.integers(13))), whole[0], whole[1], clock, rate, rest, waited),
            *(duration, start, end, by, Fault(int(rng.integers(10)))),
            *(*whole[2:], Phase(int(rng.integers(13)))),
        )
        numbers = progress.numbers()
        found = Progress.from_numbers(numbers)
        assert len(np.unique(numbers[3:8])) == 5
        for name, value in vars(progress).items():
            assert np.array_equal(getattr(found, name), value), name
            assert type(getattr(found, name)) is type(value), name


def test_a_quadruped_s_swing_turns_its_foot_and_a_tripod_s_keeps_its_heading():
    for limbs in (3, 4):
        geometry, job, beginning, _ = job_of(limbs)
        panel = job.panel
        foot = beginning.feet[0]
        turned = panel.foothold(0.2, 0.0, panel.heading(foot) + 0.3)
        swing = Swing(beginning.pose, LockSet.printed(geometry, 1), turned)
        sequence = Sequence(geometry, replace(job, operations=(swing,)), PERIOD, PARAMS)
        plant, progress = Plant(sequence, beginning), Progress()
        while progress.phase is not Phase.DONE:
            progress = sequence.advanced(progress, plant.seen(progress))
        landed = panel.heading(plant.feet[0]) - panel.heading(foot)
        assert landed == pytest.approx(0.3 if limbs == 4 else 0.0, abs=1e-9)
        assert np.allclose(plant.feet[0, :3], turned[:3], atol=1e-12)


# --- by hand


class ByHand:
    """A centre without a job, of which a person asks something at every instant."""

    def __init__(self, limbs, leg=0.3):
        speeds = replace(FASTER, leg=leg)
        self.geometry, self.job = CentreGeometry(limbs), Job(panel=Panel(3.0), speeds=speeds)
        self.home = standing(self.geometry, self.job.panel, 0.52)
        self.sequence = Sequence(self.geometry, self.job, PERIOD, PARAMS)
        self.plant, self.progress = Plant(self.sequence, self.home), Progress()

    def ask(self, seconds, by=(0.0,) * 6, limb=0):
        """Asks for a pose by its distance from the one at first, or a limb; phases on the way."""
        asked, phases = np.array([*(self.home.pose + np.array(by)), limb]), []
        for _ in range(round(seconds / PERIOD)):
            seen = self.plant.seen(self.progress, asked=asked)
            self.progress = self.sequence.advanced(self.progress, seen)
            phases.append(self.progress.phase)
        return phases


@LIMBS
def test_the_platform_goes_where_a_person_asks_it_to_and_stays(limbs):
    centre, by = ByHand(limbs), np.array((0.02, -0.01, -0.02, 0.03, 0.0, 0.05))
    assert Phase.RECONFIGURATION in centre.ask(8.0, by)
    np.testing.assert_allclose(centre.plant.pose, centre.home.pose + by, atol=1e-9)
    assert set(centre.ask(1.0, by)) == {Phase.SETTLED}


@LIMBS
@pytest.mark.parametrize(
    "by",
    [(0.0, 0.0, -0.034, 0.0, 0.0, 0.0), (0.0, 0.0, 0.3, 0.0, 0.0, 0.0)],
    ids=["into the panel", "out of the stroke"],
)
def test_the_platform_stays_where_it_is_rather_than_go_where_it_must_not(limbs, by):
    centre = ByHand(limbs)
    assert Phase.RECONFIGURATION not in centre.ask(4.0, by)
    np.testing.assert_array_equal(centre.plant.pose, centre.home.pose)
    assert Phase.RECONFIGURATION in centre.ask(4.0, (0.0, 0.0, -0.028, 0.0, 0.0, 0.0))


@LIMBS
def test_a_foot_is_lifted_and_put_down_where_it_was(limbs):
    centre = ByHand(limbs)
    phases = centre.ask(6.0, limb=2)
    assert [p for k, p in enumerate(phases) if k == 0 or p is not phases[k - 1]][1:6] == [
        *(Phase.SETTLED, Phase.LOCK, Phase.UNCLAMP, Phase.SWING, Phase.CLAMP),
    ]
    centre.ask(8.0)
    off = centre.plant.feet - centre.home.feet
    assert np.abs(off[:, :3]).max() < 1e-6
    assert centre.plant.clamps.all()


@LIMBS
def test_no_foot_is_lifted_that_a_job_could_not_swing(limbs):
    centre = ByHand(limbs, leg=1e-3)
    assert set(centre.ask(4.0, limb=1)) <= {Phase.WAITING, Phase.SETTLED}
