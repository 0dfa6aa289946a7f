"""Measure the slip of the feet while the legs lift the platform and while the arm swings.

Section 7 of the paper, Fig. 23. The legs raise the platform at level attitude; once it has settled
the actuators are braked, at 0 V behind self-locking screws, and the arm swings. The solver's own
creep, without the arm, is measured apart on inclined ground. A real machine, which must stand on
its feet on level ground, is measured by its own sensors.

Gains are off by up to 15 %. Seeds 0..19:

* While the arm swings the feet slip by .0010 mm at most (paper: less than .01 mm), of which .0003
  mm stay.
* While the actuators move the feet slip by 3.5 mm (paper: about 3 mm): the curve of the feet as
  the legs turn. Encoders alone show 3.52 mm of the true 3.51 mm. A platform that slips as a whole
  moves no encoder.
* The height stays .03 to .06 mm below the command, of which .04 mm are rods and feet that yield.
  Without integral action friction and load would hold the position controllers .7 mm below.

Creep is the solver's. Friction is regularised, so that a foot under a tangential force creeps: the
whole platform moves down the slope and keeps its posture. On 5 deg, in mm/s:

| | 1 ms | 2 ms | 4 ms |
|---|---|---|---|
| full legs, lagged or similar contact | .0194 | .0307 | .0604 |
| full legs, sap | .0154 | .0304 | .0595 |
| reduced legs, lagged or similar contact | .0194 | .0194 | .0194 |
| reduced legs, sap | .0036 | .0071 | .0139 |

It is proportional to the time step down to a floor set by Drake's stiction tolerance of .1 mm/s,
where reduced legs are at any of these steps. With sap it has none, but the feet sink into the
ground: at 1 ms by .47 mm with full legs and by .11 mm with reduced ones, against .005 mm with
lagged contact.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import (
    LevellingScenario,
)
from parapod.sims.lab.experiment import Experiment, Logged
from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.slip.measured import (
    Measured,
    Times,
    measure_lift,
    measured_figures,
    measured_metrics,
    measured_notes,
)
from parapod.sims.levelling_platform.slip.scenario import BEGIN, LEVEL, SlipScenario
from parapod.sims.levelling_platform.slip.simulated import (
    CREEP_STEPS,
    Recording,
    creep,
    creep_metrics,
    figures,
    lift_and_swing,
    lift_metrics,
    slip_metrics,
)
from parapod.sims.output.drawn import LogDrawing
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.core.errors import ScenarioError, UnreachablePosture
from parapod.systems.levelling_platform.kinematics import inverse_kinematics

_NOTES = (
    "The creep is the solver's: its friction is regularised, so that a foot under a tangential "
    "force never quite stands still. It carries the whole platform down the slope, not its "
    "posture. With full legs it goes with the time step from 2 ms on; at 1 ms, and with reduced "
    "legs at any step, it is at the floor that Drake's stiction tolerance of 0.1 mm/s sets for "
    "lagged and similar contact; with sap, which has no such floor, it goes with the time step "
    "throughout.",
    "Most of the arm's slip is elastic and comes back; arm_slip_left_mm is what stays.",
)


@dataclass(frozen=True)
class Slipped:
    """Lift and swing, and the creep apart.

    Attributes:
        recording: the lift with the swing that follows it, or as a real machine measures it.
        creep: speed of the support points on inclined ground for each of `CREEP_STEPS` [m/s];
            empty for a real machine.
    """

    recording: Recording | Measured
    creep: list[float]


class Slip(Experiment[SlipScenario, Slipped]):
    """Lifts, swings, and measures the creep apart."""

    schema = SlipScenario
    machine = PLATFORM
    drawing = LogDrawing(
        PLATFORM,
        {"legs.extension": "truth.extension", "arm.position_command": "truth.arm_position"},
        plots=("truth.posture[0:2]", "truth.posture[2]", "truth.extension", "truth.arm_position"),
    )
    backends = ("multibody", "hardware")
    takes = "30 s"

    def machine_scenario(self, scenario: SlipScenario) -> LevellingScenario:
        """The machine with sensors as they are, for its emulation."""
        levelling = scenario.levelling
        machine = replace(levelling.machine, sensors=scenario.machine.sensors)
        return replace(levelling, machine=machine)

    def check(self, scenario: SlipScenario) -> None:
        """Refuses a height that the legs do not reach.

        Raises:
            ScenarioError: names the key.
        """
        key, height = "lift.height_mm", scenario.height
        try:
            inverse_kinematics(scenario.machine.geometry, (0.0, 0.0, height), LEVEL)
        except UnreachablePosture as error:
            words = f"{key} = {1e3 * height:g} is out of reach: {error}"
            raise ScenarioError(words, key) from error

    def run(self, scenario: SlipScenario, runner: Runner) -> Slipped:
        """Lifts and swings on level ground, then stands still on a slope.

        Raises:
            RefusedRequest: a real machine that does not stand on its feet.
        """
        if scenario.backend == "hardware":
            times = Times.from_scenario(scenario, BEGIN)
            machine = scenario.levelling
            return Slipped(measure_lift(scenario, machine, times, runner), [])
        recording = lift_and_swing(scenario, runner)
        return Slipped(recording, [creep(scenario, step, runner) for step in CREEP_STEPS])

    def logged(self, scenario: SlipScenario, data: Slipped) -> Logged:
        """Signals of lift and swing."""
        recording = data.recording
        assert isinstance(recording, Recording)  # a real machine's log is written meanwhile
        signals = {
            "truth.support_points": (recording.feet, "m"),
            "truth.posture": (recording.posture, "rad, rad, m"),
            "truth.extension": (recording.extension, "m"),
            "truth.arm_position": (recording.arm, "rad"),
        }
        return recording.time, signals

    def measure(self, scenario: SlipScenario, data: Slipped) -> Iterator[Metric]:
        """Slip of lift and swing, errors of the lift, creep by time step."""
        if isinstance(data.recording, Measured):
            yield from measured_metrics(scenario, data.recording)
            return
        yield from slip_metrics(scenario, data.recording)
        yield from lift_metrics(scenario, data.recording)
        yield from creep_metrics(scenario, data.creep)

    def note(self, scenario: SlipScenario, data: Slipped) -> Iterable[str]:
        """The creep's cause, or what a real machine does not see."""
        if isinstance(data.recording, Measured):
            return measured_notes(data.recording)
        return _NOTES

    def draw(self, scenario: SlipScenario, data: Slipped) -> Iterable[Figure]:
        """Motion and slip (Fig. 23)."""
        if isinstance(data.recording, Measured):
            return measured_figures(data.recording)
        return figures(scenario, data.recording)
