"""Carry out the whole operation: drive there, stand up, work, leave.

Section 2.2 of the paper. The platform does not know the ground. It drives on four wheels with its
legs up, brakes, lowers each leg until its contact switch closes, estimates the ground and how
uneven it is, lifts its wheels, takes the commanded posture, holds it while the arm works, and goes
away again.

Measured, default scenario (ground of 2 and 3 deg, feet 0 to 20 mm above it, noise, biases, gains
off by up to 15 %), multibody: roll and pitch within .08 deg, height within .14 mm, wheels 76 mm
clear, no change of a voltage above .3 V from one period to the next. Kinematic, seeds 0..199: roll
and pitch within .11 deg, height within .22 mm, no finding without a fault. On four feet the arm of
1 kg keeps a stability margin of 435 mm in the worst case of a 90 deg swing on 5 deg of ground.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.levelling_platform.controller import make_supervised_controller
from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.disturbances import Disturbance
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import (
    SIMULATED,
    ControlScenario,
    GroundScenario,
    JobScenario,
    LevellingScenario,
    PlantScenario,
    PlatformFault,
    emulated_hardware,
)
from parapod.diagrams.recording import spans
from parapod.sims.lab.experiment import LoopExperiment
from parapod.sims.lab.panel import Readout
from parapod.sims.lab.run import Monitor, Run, realtime_metric
from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.levelling import (
    AXES,
    error_metrics,
    in_deg_and_mm,
    make_scene,
)
from parapod.sims.levelling_platform.operation import (
    OperationWatch,
    PhaseLabel,
    has_arm,
    operated_platform,
    read_operation,
)
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.arm.serial_arm import SerialArm
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.levelling_platform.fault_detection import Finding
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.kinematics import forward_kinematics
from parapod.systems.levelling_platform.plane import normal_of, to_platform
from parapod.systems.levelling_platform.scripts import OperatorScript, Step
from parapod.systems.levelling_platform.stability_monitor import usual_margin
from parapod.systems.levelling_platform.supervisor import Command, Phase

type Signals = Mapping[str, NDArray[Any]]

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

# Between one thing that the operator does and the next [s].
_PAUSE = 1.0
# A phase that is shorter has no room for its name [s].
_NAMED = 1.5
# What the paper's closed loop stayed within (section 7).
_ANGLE_BOUND, _HEIGHT_BOUND = 0.2, 2.0
_PAPER = (0.2, 0.2, 2.0)
_NOT_HELD = "the platform held no posture"
_LIFTED = 0.5  # a foot that is back sooner has not been lost [s]
_CLEARANCE = 20.0  # clearance of the wheels of the paper's platform while it works [mm]
# A command that jumps is one that changes in a period by more than this share of the supply [-].
_VOLTAGE_STEP = 0.5 / 12.0


def uneven_ground() -> GroundScenario:
    """Ground that is inclined, and higher under three of the feet."""
    return GroundScenario(2.0, 3.0, [20.0, 0.0, 12.0, 5.0])


@dataclass
class DriveScenario(Schema):
    """The ways there and back, straight ahead.

    Attributes:
        distance_m: distance of each way [m].
        speed_m_s: speed [m/s].
    """

    distance_m: float = quantity(0.6, 0.0, 100.0)
    speed_m_s: float = quantity(0.3, 0.01, 2.0)

    @property
    def duration(self) -> float:
        """Duration of one way [s]."""
        return self.distance_m / self.speed_m_s


@dataclass
class WorkScenario(Schema):
    """The work of the platform while it stands.

    Attributes:
        roll_deg: roll of the posture [deg].
        pitch_deg: pitch of the posture [deg].
        height_mm: height of the posture above the mean of the ground under the feet [mm]; null:
            that of a levelling.
        arm_deg: angle to which the arm's second joint, or its only one, swings and from which it
            comes back [deg].
        turn_deg: angle of the joint before it meanwhile, the drawn arm's turntable [deg].
        hold_s: time at rest before, between and after the arm's moves [s].
    """

    roll_deg: float = quantity(0.0, -10.0, 10.0)
    pitch_deg: float = quantity(0.0, -10.0, 10.0)
    height_mm: float | None = quantity(None, 0.0, 20_000.0)
    arm_deg: float = quantity(45.0, -120.0, 120.0)
    turn_deg: float = quantity(0.0, -360.0, 360.0)
    hold_s: float = quantity(2.0, 0.5, 3600.0)

    def positions(self, arm: SerialArm) -> tuple[float, ...]:
        """Positions (n) of the arm's joints meanwhile [rad or m]."""
        return arm.leaning(math.radians(self.arm_deg), math.radians(self.turn_deg))


@dataclass
class DeployScenario(Schema):
    """One operation: drive there, stand up, work, leave.

    Attributes:
        backend: plant behind the station's ports: "multibody" (rigid bodies and contact),
            "kinematic" (quasi-static) or "hardware" (devices).
        seed: seed of everything random: gains, biases, noise.
        ground: see `GroundScenario`; the wheels need foot heights of 0 or more.
        drive: see `DriveScenario`.
        work: see `WorkScenario`.
        plant: see `PlantScenario`; the wheels roll.
        machine: see `PlatformDesign`; or a file: `!File my_machine.yaml`.
        control: see `ControlScenario`.
        disturbances: pushes, payload and moving ground, of a simulated machine; see
            `Disturbance`.
        faults: faults of the machine's signals; see `PlatformFault`.
        hardware: see `HardwareScenario`; the defaults are the emulated devices.
        longest: time after which an operation that has not come to its end is ended [s].
    """

    moved = {"actuators": "machine.actuators", "sensors": "machine.sensors"}  # noqa: RUF012

    backend: str = choice("multibody", (*SIMULATED, "hardware"))
    seed: int = quantity(0, 0, 2**31 - 1)
    ground: GroundScenario = field(default_factory=uneven_ground)
    drive: DriveScenario = field(default_factory=DriveScenario)
    work: WorkScenario = field(default_factory=WorkScenario)
    plant: PlantScenario = field(default_factory=PlantScenario)
    machine: PlatformDesign = field(default_factory=PlatformDesign)
    control: ControlScenario = field(default_factory=ControlScenario)
    disturbances: list[Disturbance] = field(default_factory=list)
    faults: list[PlatformFault] = field(default_factory=list)
    hardware: HardwareScenario = field(default_factory=emulated_hardware)
    longest: float = quantity(120.0, 1.0, 7200.0)

    @property
    def levelling(self) -> LevellingScenario:
        """The machine on its wheels, on its way."""
        return LevellingScenario(
            backend=self.backend,
            seed=self.seed,
            ground=self.ground,
            plant=self.plant,
            machine=self.machine,
            control=self.control,
            job=JobScenario(start="wheels", start_x_m=-self.drive.distance_m),
            disturbances=self.disturbances,
            faults=self.faults,
            hardware=self.hardware,
        )

    @property
    def posture(self) -> tuple[float, float, float]:
        """Roll, pitch, height of the work [rad, rad, m]."""
        work, height = self.work, self.machine.working_height
        if work.height_mm is not None:
            height = 1e-3 * work.height_mm
        return math.radians(work.roll_deg), math.radians(work.pitch_deg), height

    def steps(self) -> tuple[Step, ...]:
        """Steps of the operator."""
        transport, hold = Phase.TRANSPORT, Phase.HOLD
        ahead, stop = (self.drive.speed_m_s, 0.0), (0.0, 0.0)
        arm = self.machine.masses.arm
        return (
            Step(transport, _PAUSE, drive=ahead),
            Step(transport, self.drive.duration, drive=stop),
            Step(transport, _PAUSE, Command.GO),
            Step(hold, self.work.hold_s, arm=self.work.positions(arm)),
            Step(hold, self.work.hold_s + _PAUSE, arm=(0.0,) * arm.count),
            Step(hold, self.work.hold_s + _PAUSE, Command.STOP),
            Step(transport, _PAUSE, drive=ahead),
            Step(transport, self.drive.duration, drive=stop),
            Step(transport, _PAUSE),
        )


@dataclass(frozen=True)
class Operation:
    """An operation that has come to its end.

    Attributes:
        run: the run.
        steps_left: number of the operator's steps that were not done.
        watch: the monitor that ended it.
    """

    run: Run
    steps_left: int
    watch: OperationWatch


class Deploy(LoopExperiment[DeployScenario, Operation]):
    """Carries out the operation."""

    machine = PLATFORM
    schema = DeployScenario
    backends = (*SIMULATED, "hardware")
    signals = (
        "truth.posture",
        "legs.extension",
        "legs.limits",
        "legs.voltage",
        "attitude_estimated",
        "ground_estimated",
        "foot_offsets_estimated",
        "extension_desired_state",
        "phase",
        "stability_margin",
        "arm.position_command",
        "findings",
    )
    takes = "20 s"
    advice = (
        "Operate the platform in the browser: drive it, 'Go' lowers its legs and levels it, "
        "'Stop' raises them, 'Reset' ends a fault."
    )

    def needed(self, scenario: DeployScenario) -> tuple[str, ...]:
        """See `LoopExperiment`; nothing of an arm that is not there."""
        names = super().needed(scenario)
        if has_arm(scenario.levelling):
            return names
        return tuple(name for name in names if not name.startswith("arm."))

    def duration(self, scenario: DeployScenario) -> float:
        """End of an operation that does not come to its end [s]."""
        return scenario.longest

    def machine_scenario(self, scenario: DeployScenario) -> LevellingScenario:
        """See `LoopExperiment`."""
        return scenario.levelling

    def structure(self, scenario: DeployScenario) -> str:
        """See `LoopExperiment`; the operator's script is built in."""
        script = scenario.steps(), scenario.posture
        return f"{self.machine.structure(scenario.levelling)} {script!r}"

    def operated(
        self, scenario: DeployScenario, controls: Any, meshcat: Meshcat | None = None
    ) -> ClosedLoop[LevellingScenario]:
        """A person in place of the script."""
        return operated_platform(scenario.levelling, scenario.posture[2], controls, meshcat)

    def loop(self, scenario: DeployScenario, **options: Any) -> ClosedLoop[LevellingScenario]:
        """The machine with its supervisor and an operator."""
        machine = scenario.levelling
        period, arm = machine.control.period, machine.machine.masses.arm
        operator = OperatorScript(scenario.steps(), scenario.posture, period, arm.count)
        parts: dict[str, Any] = {
            "controller": make_supervised_controller,
            "sources": [operator],
        }
        return ClosedLoop(PLATFORM, machine, **(parts | options))

    def scene(self, scenario: DeployScenario) -> Meshcat:
        """The ground's slope against a horizontal floor."""
        return make_scene(scenario.levelling)

    def run(self, scenario: DeployScenario, runner: Runner) -> Operation:
        """Runs until the operator has nothing left to do, or something is refused."""
        watches: list[OperationWatch] = []

        def monitor(loop: ClosedLoop[Any], meshcat: Meshcat | None) -> Monitor:
            label = PhaseLabel(meshcat) if meshcat and runner.options.html else None
            is_real = scenario.backend == "hardware"
            steps = len(scenario.steps())
            watches.append(OperationWatch(loop, steps, label, ends_at_fault=is_real))
            return watches[-1].look

        run = self.run_loop(scenario, runner, monitor=monitor)
        return Operation(run, watches[-1].steps_left(run.context), watches[-1])

    def measure(self, scenario: DeployScenario, data: Operation) -> Iterator[Metric]:
        """Errors while held, margins, smoothness and findings.

        Raises:
            UnreachablePosture: a ground that cannot be levelled, or a posture out of reach.
            RefusedRequest: any other request that the machine does not carry out.
        """
        run = data.run
        data.watch.raise_refusal(run.context)
        meaning = "steps of the operator's plan that were not done"
        yield Metric("steps_left", data.steps_left, "", 0.0, meaning=meaning)
        yield from _posture(scenario, run)
        yield from _standing(scenario, run)
        yield from _smoothness(scenario, run)
        yield _findings(scenario, run)
        yield realtime_metric(run)

    def note(self, scenario: DeployScenario, data: Operation) -> Iterator[str]:
        """Findings, durations of the phases, order of touchdown."""
        for name, at in found_faults(data.run).items():
            yield f"found at {at:.2f} s: {name}"
        times = phase_times(data.run)
        yield "phases: " + ", ".join(f"{name} {lasted:.1f} s" for name, lasted in times.items())
        yield "feet touched in the order of legs " + ", ".join(map(str, contact_order(data.run)))

    def details(self, scenario: DeployScenario, data: Operation) -> Mapping[str, Any]:
        """Durations of the phases, order of touchdown, findings."""
        return {
            "phase_times_s": phase_times(data.run),
            "contact_order": contact_order(data.run),
            "found_s": found_faults(data.run),
        }

    def read_out(self, loop: ClosedLoop[Any], root_context: Context) -> Readout:
        """Phase, posture, margin, faults and refusals."""
        return read_operation(loop, root_context)

    def draw(self, scenario: DeployScenario, data: Operation) -> Iterable[Figure]:
        """The operation over time, and its legs."""
        return figures(scenario, data.run.time, data.run)


def figures(
    scenario: DeployScenario, time: NDArray[np.float64], signals: Signals
) -> tuple[Figure, ...]:
    """The operation over time, and its legs."""
    return (
        Figure(
            "deploy_posture",
            "The operation",
            "Posture of the platform against gravity, and the supervisor's phases.",
            partial(_draw_posture, scenario, time, signals),
            (9.0, 5.2),
        ),
        Figure(
            "deploy_legs",
            "Legs and arm",
            "Extensions with the closing of the contact switches (dots), and the arm's angle.",
            partial(_draw_legs, time, signals),
            (9.0, 4.2),
        ),
    )


def _draw_posture(
    scenario: DeployScenario,
    time: NDArray[np.float64],
    signals: Signals,
    canvas: "Canvas",
) -> None:
    posture = in_deg_and_mm(posture_of(scenario, signals))
    rows: Any = canvas.subplots(3, 1, sharex=True)
    for i, (axes, (_, _, label)) in enumerate(zip(rows, AXES, strict=True)):
        axes.plot(time, posture[:, i])
        axes.set_ylabel(label)
        _mark_phases(axes, time, signals, named=i == 0)
    rows[-1].set_xlabel("time [s]")


def _draw_legs(time: NDArray[np.float64], signals: Signals, canvas: "Canvas") -> None:
    legs, arm = canvas.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    extension = 1e3 * signals["legs.extension"]
    contact = signals["legs.limits"][:, 2 * LEG_COUNT :] > 0.5
    for i in range(LEG_COUNT):
        (line,) = legs.plot(time, extension[:, i], label=f"leg {i + 1}")
        if contact[:, i].any():
            first = int(np.argmax(contact[:, i]))
            legs.plot(time[first], extension[first, i], "o", color=line.get_color(), ms=4)
    legs.set_ylabel("extension [mm]")
    legs.legend(fontsize=8, ncols=LEG_COUNT, loc="upper center")
    if "arm.position_command" in signals:
        arm.plot(time, np.degrees(signals["arm.position_command"]))
    arm.set(ylabel="arm [deg]", xlabel="time [s]")
    _mark_phases(legs, time, signals, named=True)
    _mark_phases(arm, time, signals, named=False)


def _mark_phases(axes: "Axes", time: NDArray[np.float64], signals: Signals, named: bool) -> None:
    """Bands behind the curves, one a phase."""
    phase = signals["phase"][:, 0]
    edges = [0, *(np.flatnonzero(np.diff(phase)) + 1).tolist(), phase.size - 1]
    for k, (begin, end) in enumerate(pairwise(edges)):
        if k % 2:
            axes.axvspan(time[begin], time[end], color="0.95", zorder=0)
        if named and time[end] - time[begin] >= _NAMED:
            axes.annotate(
                Phase(int(phase[begin])).name.lower(),
                (0.5 * (time[begin] + time[end]), 1.02),
                xycoords=("data", "axes fraction"),
                ha="center",
                fontsize=7,
            )


def phase_times(run: Run) -> dict[str, float]:
    """Durations of the phases, all visits of each together [s]."""
    phase = run["phase"][:, 0]
    period = float(run.time[1] - run.time[0])
    return {
        each.name.lower(): round(period * int((phase == each).sum()), 6)
        for each in Phase
        if (phase == each).any()
    }


def contact_order(signals: Signals) -> list[int]:
    """Numbers of the legs in the order in which their switches closed first."""
    contact = signals["legs.limits"][:, 2 * LEG_COUNT :] > 0.5
    touched = [leg for leg in range(LEG_COUNT) if contact[:, leg].any()]
    return [leg + 1 for leg in sorted(touched, key=lambda leg: int(np.argmax(contact[:, leg])))]


def found_faults(run: Run) -> dict[str, float]:
    """Findings and when they were made [s]."""
    findings = run["findings"] > 0.5
    return {
        finding.name.lower(): round(float(run.time[np.argmax(findings[:, finding])]), 6)
        for finding in Finding
        if findings[:, finding].any()
    }


def _findings(scenario: DeployScenario, signals: Signals) -> Metric:
    count = float((signals["findings"] > 0.5).any(axis=0).sum())
    bound, meaning = (None, "faults were injected") if scenario.faults else (0.0, "false alarms")
    return Metric("findings", count, "", bound, meaning=f"kinds of faults found; {meaning}")


def _holding(signals: Signals) -> NDArray[np.bool_]:
    holding: NDArray[np.bool_] = signals["phase"][:, 0] == Phase.HOLD
    return holding


def _posture(scenario: DeployScenario, signals: Signals) -> list[Metric]:
    """Errors while the posture is held, the arm's swing included."""
    desired = in_deg_and_mm(np.array(scenario.posture))
    # The height counts from the plane that fits the ground under the feet best.
    is_true = "truth.posture" in signals
    if is_true:
        desired[2] += np.mean(scenario.ground.foot_heights_mm)
    reached = in_deg_and_mm(posture_of(scenario, signals)[_holding(signals)])
    error = reached - desired if reached.size else np.full((1, 3), np.nan)
    condition = "while the posture is held, against gravity and the feet's mean height"
    if not is_true:
        condition += ", as measured"
    bounds = (_ANGLE_BOUND, _HEIGHT_BOUND * scenario.machine.size)
    return error_metrics(error, "", bounds, _PAPER, condition, _NOT_HELD)


def _standing(scenario: DeployScenario, signals: Signals) -> list[Metric]:
    is_holding = _holding(signals)
    opened = signals["legs.limits"][is_holding, 2 * LEG_COUNT :] < 0.5
    lifted = scenario.control.period * max(map(_longest, opened.T))
    return [
        Metric(
            "smallest_margin_mm",
            1e3 * _smallest(signals["stability_margin"][is_holding]),
            "mm",
            at_least=1e3 * usual_margin(scenario.machine.geometry),
            meaning="smallest margin of the zero-moment point inside the feet, while held",
            undefined=_NOT_HELD,
        ),
        Metric(
            "wheel_clearance_mm",
            1e3 * _smallest(_clearance(scenario, signals)[:, is_holding]),
            "mm",
            at_least=_CLEARANCE * scenario.machine.size,
            meaning="clearance of the lowest wheel while held",
            undefined=_NOT_HELD,
        ),
        Metric(
            "lifted_s",
            lifted,
            "s",
            _LIFTED,
            meaning="longest time for which a foot's switch is open while held",
        ),
    ]


def _longest(flags: NDArray[np.bool_]) -> int:
    """Length of the longest run of true flags."""
    return max((end - begin for begin, end in spans(flags)), default=0)


def _smallest(values: NDArray[np.float64]) -> float:
    return float(values.min()) if values.size else np.nan


def posture_of(scenario: DeployScenario, signals: Signals) -> NDArray[np.float64]:
    """Postures (n, 3) [rad, rad, m]: the true ones, or on a real machine the measured ones.

    The measured ones follow from inertial sensor, extensions and estimated ground.
    """
    if "truth.posture" in signals:
        return signals["truth.posture"]
    legs = forward_kinematics(
        scenario.levelling.geometry_as_known,
        signals["legs.extension"] + scenario.control.encoder_offsets,
        signals["ground_estimated"],
        foot_offsets=signals["foot_offsets_estimated"],
    )
    return np.column_stack((signals["attitude_estimated"], legs[:, 2]))


def _clearance(scenario: DeployScenario, signals: Signals) -> NDArray[np.float64]:
    """Clearance of the wheels (4, n) above the ground's plane [m]."""
    wheels, posture = scenario.machine.wheel_geometry, posture_of(scenario, signals)
    ground: Any = scenario.ground.inclination
    if "truth.posture" not in signals:
        ground = signals["ground_estimated"].T
    normal = normal_of(*ground)
    g = np.array(to_platform(normal, posture[:, 0], posture[:, 1]))
    below = np.array(wheels.axles) @ g.reshape(3, -1)
    clearance: NDArray[np.float64] = posture[:, 2] + below - wheels.radius
    return clearance


def _smoothness(scenario: DeployScenario, signals: Signals) -> list[Metric]:
    """Commands that do not jump, at transitions least of all."""
    desired = signals["extension_desired_state"][:, :LEG_COUNT]
    fastest = 1e3 * scenario.control.period * 1.5 * scenario.machine.supervisor.raising_rate
    return [
        Metric(
            "largest_voltage_step_V",
            float(np.abs(np.diff(signals["legs.voltage"], axis=0)).max()),
            "V",
            _VOLTAGE_STEP * scenario.machine.actuators.supply_voltage,
            meaning="largest change of a command from one period to the next",
        ),
        Metric(
            "largest_extension_step_mm",
            1e3 * float(np.abs(np.diff(desired, axis=0)).max()),
            "mm",
            fastest,
            meaning="largest change of a desired extension in a period",
        ),
    ]
