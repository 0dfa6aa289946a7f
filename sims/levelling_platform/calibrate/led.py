"""Poses of a real machine: it is led through them, and a person measures it from outside.

In each pose the legs are brought to their places, leg 4 is trimmed until all feet touch, and the
legs are left without a command: they are self-locking. Encoders and inertial sensor are averaged
at rest; then what an instrument outside tells is asked for, and the recording is written.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, System
from pydrake.systems.primitives import ConstantVectorSource

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.wiring import add
from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.calibrate.recording import spread_commands
from parapod.sims.levelling_platform.calibrate.scenario import CalibrateScenario
from parapod.sims.levelling_platform.leg_job import (
    AT_REST,
    LegJob,
    LegWatch,
    carry_out,
    refuse_unless_standing,
)
from parapod.sims.real_machine.answers import Answers
from parapod.systems.core.quoting import quoted
from parapod.systems.levelling_platform.calibration.poses import PoseRecording
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.kinematics import forward_kinematics, passive_extension

type Floats = NDArray[np.float64]

# Time for which all feet must touch, and after which a foot in the air is recorded as one [s].
_TOUCHING, _PATIENCE = 0.5, 8.0
# The workspace itself is inclined by up to some 8 deg, on ground that may be inclined too [rad].
_TILT = math.radians(12.0)
# An answer that is further from what the machine's own sensors measure is a mistake [m, rad].
_HEIGHT, _INCLINATION = 15e-3, math.radians(1.5)
# Ends when all poses are done [s].
_ENDLESS = 1e6
COLUMNS = ("height_mm", "roll_deg", "pitch_deg")


@dataclass(frozen=True)
class Outside:
    """Posture that an instrument outside has measured.

    Attributes:
        height: height above the ground's plane [m].
        inclination: roll and pitch [rad]; NaN where they were not measured.
    """

    height: float
    inclination: tuple[float, float] = (math.nan, math.nan)


def parsed_answer(text: str, expected: Floats, is_tracked: bool) -> Outside:
    """An answer, in the units in which people give it.

    Args:
        text: numbers with blanks between them: height [mm], and where tracked roll and pitch
            [deg].
        expected: roll, pitch and height (3) by the machine's own sensors [rad, rad, m].
        is_tracked: true if roll and pitch are asked for.

    Raises:
        ValueError: an answer that cannot be; says what can.
    """
    count = len(COLUMNS) if is_tracked else 1
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        raise ValueError(f"{quoted(text)} is not {_asked(is_tracked)}") from None
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise ValueError(f"{quoted(text)} is not {_asked(is_tracked)}")
    height, *degrees = numbers
    inclination = tuple(map(math.radians, degrees)) or (math.nan, math.nan)
    checks = [("height", 1e-3 * height, expected[2], _HEIGHT, 1e3, "mm")]
    if is_tracked:
        checks += [
            (name, inclination[i], expected[i], _INCLINATION, math.degrees(1.0), "deg")
            for i, name in enumerate(("roll", "pitch"))
        ]
    for name, value, near, tolerance, scale, unit in checks:
        if not abs(value - near) <= tolerance:
            raise ValueError(
                f"{name} {scale * value:g} {unit} is not within {scale * tolerance:g} {unit} of "
                f"{scale * near:.1f} {unit}, which the machine's own sensors measure"
            )
    return Outside(1e-3 * height, (inclination[0], inclination[1]))


def _asked(is_tracked: bool) -> str:
    names = [name.replace("_", " [") + "]" for name in COLUMNS]
    return ", ".join(names) if is_tracked else names[0]


class _Step(Enum):
    LEAD = auto()
    REST = auto()
    ASK = auto()


class PoseWatch(LegWatch):
    """Leads the legs from pose to pose, averages at rest, and asks.

    Attributes:
        poses: recorded poses so far: extension, attitude, contact, height, reference of each.
    """

    signals = (*LegWatch.signals, "legs_arrived")
    tilt_limit = _TILT

    def __init__(
        self,
        loop: ClosedLoop[Any],
        scenario: CalibrateScenario,
        commands: Floats,
        answers: Answers,
        write: Any,
    ):
        """Begins with the first pose.

        Args:
            loop: closed loop of a `LegJob` with `hand` as its source.
            scenario: the scenario.
            commands: extensions (n, 4) of the poses [m].
            answers: asks for what was measured from outside.
            write: called with the recording after each pose.
        """
        super().__init__(loop)
        self._scenario, self._commands = scenario, commands
        self._answers, self._write = answers, write
        (self._hand,) = loop.sources
        self._step, self._since, self._touched = _Step.REST, math.inf, 0.0
        self._averaged: tuple[Floats, Floats, NDArray[np.bool_]] | None = None
        self.poses: list[tuple[Floats, Floats, NDArray[np.bool_], Outside]] = []

    def check_beginning(self) -> None:
        """See `LegWatch`."""
        refuse_unless_standing(self)

    def look(self, root: Context) -> bool:
        """See `LegWatch`.

        Raises:
            NoAnswer: the source of the answers has ended.
        """
        is_new = super().look(root)
        now = root.get_time()
        if not is_new or now < AT_REST:
            return is_new
        if math.isinf(self._since):
            self._lead(root, now)
        elif self._step is _Step.LEAD:
            self._look_for_ground(root, now)
        elif self._step is _Step.REST:
            self._average(now)
        elif (text := self._answers.take()) is not None:
            self._judge(root, now, text)
        # Of what is over, nothing is needed.
        sample_count = 2 + round(
            self._scenario.measuring.average_s / self._loop.scenario.control.period
        )
        for column in self.rows.values():
            del column[:-sample_count]
        return is_new

    def _go_on(self, step: _Step, now: float) -> None:
        self._step, self._since, self._touched = step, now, now

    def _lead(self, root: Context, now: float) -> None:
        command = self._commands[len(self.poses)]
        ask_for(self._hand, root, command, is_led=True)
        self._go_on(_Step.LEAD, now)

    def _look_for_ground(self, root: Context, now: float) -> None:
        """Waits until the legs have arrived and all feet touch."""
        if not self.newest("legs_arrived")[0] > 0.5:
            self._go_on(_Step.LEAD, now)
            return
        if not self.touching.all():
            self._touched = now
        if now - self._touched >= _TOUCHING or now - self._since >= _PATIENCE:
            ask_for(self._hand, root, self._commands[len(self.poses)], is_led=False)
            self._go_on(_Step.REST, now)

    def _average(self, now: float) -> None:
        """Averages at rest, and asks."""
        measuring = self._scenario.measuring
        if now - self._since < measuring.rest_s + measuring.average_s:
            return
        count = round(measuring.average_s / self._loop.scenario.control.period)
        extension = self.column("legs.extension")[-count:].mean(axis=0)
        bias = self._loop.scenario.control.inclination_bias
        attitude = self.column("attitude_estimated")[-count:].mean(axis=0) + bias
        limits = self.column("legs.limits")[-count:, 2 * LEG_COUNT :]
        self._averaged = extension, attitude, (limits > 0.5).all(axis=0)
        self._go_on(_Step.ASK, now)
        self._ask()

    def _ask(self) -> None:
        number, count = len(self.poses) + 1, len(self._commands)
        request = _asked(self._scenario.poses.tracked)
        self._answers.ask(number, f"pose {number} of {count} is at rest: {request}?")

    def _judge(self, root: Context, now: float, text: str) -> None:
        """Takes an answer, or asks again."""
        assert self._averaged is not None
        extension, attitude, contact = self._averaged
        control = self._loop.scenario.control
        height = forward_kinematics(
            self._loop.scenario.geometry_as_known,
            extension + control.encoder_offsets,
            self._scenario.ground.inclination,
            (0, 1, 2),
        )[2]
        expected = np.append(attitude - control.inclination_bias, height)
        try:
            outside = parsed_answer(text, expected, self._scenario.poses.tracked)
        except ValueError as error:
            self._answers.say(str(error))
            self._ask()
            return
        self.poses.append((extension, attitude, contact, outside))
        self._write(self.recording())
        self.is_over = len(self.poses) == len(self._commands)
        if not self.is_over:
            self._lead(root, now)

    def recording(self) -> PoseRecording:
        """The poses so far."""
        extension, attitude, contact, outside = zip(*self.poses, strict=True)
        return PoseRecording(
            extension=np.array(extension),
            attitude=np.array(attitude),
            height=np.array([pose.height for pose in outside]),
            contact=np.array(contact),
            noise=self._scenario.noise.deviations,
            reference=np.array([pose.inclination for pose in outside])
            if self._scenario.poses.tracked
            else None,
        )


def make_hand() -> Sequence[System]:
    """The source of a `LegJob` whose requests `ask_for` sets."""
    builder = DiagramBuilder()
    for name, size in (("extension_request", 2 * LEG_COUNT), ("legs_enable", 1)):
        source = add(builder, ConstantVectorSource(np.zeros(size)), name)
        builder.ExportOutput(source.get_output_port(), name)
    diagram = builder.Build()
    diagram.set_name("hand")
    return (diagram,)


def ask_for(hand: Diagram, root: Context, extension: Floats, is_led: bool) -> None:
    """Sets what the legs are asked for.

    Args:
        hand: made by `make_hand`.
        root: root context.
        extension: extensions (4) [m].
        is_led: true if the legs are led there; otherwise they have no command.
    """
    for name, value in (
        ("extension_request", [*extension, *[0.0] * LEG_COUNT]),
        ("legs_enable", [float(is_led)]),
    ):
        source: Any = hand.GetSubsystemByName(name)
        context = source.GetMyMutableContextFromRoot(root)
        source.get_mutable_source_value(context).SetFromVector(np.array(value))


def pose_commands(scenario: CalibrateScenario, machine: LevellingScenario) -> Floats:
    """Extensions (n, 4) of the poses, as the encoders have to tell them [m]."""
    control = machine.control
    geometry, ground = machine.geometry_as_known, scenario.ground.inclination
    random = np.random.default_rng(scenario.seed)
    start = int(random.integers(2**31))
    active = spread_commands(scenario.machine.geometry, scenario.poses.count, start)
    standing = np.column_stack([active, active[:, 0]])
    posture = forward_kinematics(geometry, standing, ground, (0, 1, 2))
    passive = passive_extension(geometry, active, ground, posture[:, :2])
    commands: Floats = np.column_stack([active, passive]) - control.encoder_offsets
    return commands


def record_poses(
    scenario: CalibrateScenario,
    machine: LevellingScenario,
    answers: Answers,
    write: Callable[[PoseRecording], None],
    runner: Runner,
) -> PoseRecording:
    """Leads a machine through the poses, and writes them after each one.

    Args:
        scenario: the scenario.
        machine: the machine, which stands on its feet.
        answers: asks for what was measured from outside.
        write: writes the poses that have been recorded.
        runner: runs the job.

    Raises:
        RefusedRequest: the machine does not stand on its feet; nothing has moved.
        NoAnswer: the source of the answers has ended.
        Tripped: the machine tilts, or its guard has found what cannot be.
        OutputError: the recording cannot be written.
    """
    commands = pose_commands(scenario, machine)
    rate = 1e-3 * scenario.measuring.rate_mm_s
    job = LegJob(runner.name, make_hand, _ENDLESS, rate, keeps_contact=True)
    make_watch = partial(
        PoseWatch, scenario=scenario, commands=commands, answers=answers, write=write
    )
    with answers.open():
        return carry_out(job, machine, runner, make_watch).recording()
