"""One foot on its circle in each control mode, simulated."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator

from parapod.diagrams.walking_chair.leg_loop import make_leg_loop
from parapod.sims.chair_circle_scenario import ChairCircleScenario
from parapod.sims.experiment import RunOptions
from parapod.sims.experiment_log import write_experiment_log
from parapod.sims.simulate import simulate, write_graphviz
from parapod.systems.actuators.compound_position_controller import MODES
from parapod.systems.walking_chair.checks import check_speeds, check_strokes
from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.leg import leg_forward
from parapod.systems.walking_chair.rates import leg_motion
from parapod.systems.walking_chair.trajectories import BranchMotion, FootCircle

type Floats = NDArray[np.float64]

GEOMETRY = LegGeometry()
# The paper's experiment is with leg 1, whose number the errors name.
_LEGS = (1,)
# By then the start is forgotten [s].
SETTLING = 1.0
_CHECKED = 1e-3  # between times at which strokes and speeds are checked [s]


@dataclass(frozen=True)
class Recording:
    """A foot on its circle.

    Attributes:
        circle: where it should be.
        time: (n) [s].
        position: (n, 3) where the drives really are [m].
        velocity: (n, 3) likewise [m/s].
        foot: (n, 3) where the corner E1 really is, in {A1} [m].
    """

    circle: FootCircle
    time: Floats
    position: Floats
    velocity: Floats
    foot: Floats

    @property
    def error(self) -> Floats:
        """(n, 3) of the foot, from where it should be at the same instant [m]."""
        return self.foot - self.circle.motion(self.time).position

    @property
    def distance(self) -> Floats:
        """(n) between the foot and where it should be at the same instant [m]."""
        return np.linalg.norm(self.error, axis=-1)

    @property
    def radial_error(self) -> Floats:
        """(n) distance from the circle's axis less the radius: the trajectory without time [m]."""
        return np.hypot(self.foot[:, 0], self.foot[:, 1] - self.circle.centre_y) - (
            self.circle.radius
        )

    @property
    def moves(self) -> NDArray[np.bool_]:
        """(n) times of the circle."""
        return self.time <= self.circle.duration

    @property
    def is_settled(self) -> NDArray[np.bool_]:
        """(n) times of the circle without its first second."""
        return self.moves & (self.time >= SETTLING)

    @cached_property
    def planned(self) -> BranchMotion:
        """What the branches should do, arrays (n, 3)."""
        return leg_motion(GEOMETRY, self.circle.motion(self.time))


def check_circle(scenario: ChairCircleScenario) -> None:
    """Refuses a circle that the branches cannot do.

    Raises:
        ScenarioError: the circle's parts do not fit together.
        StrokeExceeded: names the branch and the time of the largest excess.
        SpeedExceeded: names the branch and the time of the largest speed.
    """
    circle = scenario.circle.circle
    time = np.linspace(0.0, circle.duration, round(circle.duration / _CHECKED) + 1)
    motion = leg_motion(GEOMETRY, circle.motion(time))
    check_strokes(GEOMETRY, motion.length[:, np.newaxis], time, _LEGS)
    limit = 1e-3 * scenario.drives.max_velocity_mm_s
    check_speeds(motion.velocity[:, np.newaxis], limit, time, _LEGS)


def record(scenario: ChairCircleScenario, options: RunOptions) -> dict[str, Recording]:
    """Runs every control mode; by the mode's name.

    Raises:
        OutputError: the diagram's file cannot be written.
    """
    return {mode: _record(scenario, mode, options) for mode in MODES}


def _record(scenario: ChairCircleScenario, mode: str, options: RunOptions) -> Recording:
    params = scenario.loop(mode)
    loop = make_leg_loop(params)
    if options.graphviz is not None and mode == MODES[0]:
        write_graphviz(options.graphviz, loop.diagram)
    simulator = Simulator(loop.diagram)
    loop.reset(simulator.get_mutable_context())
    simulator.Initialize()
    until = params.circle.duration + scenario.rest
    simulate(simulator, until, options.console, f"mode {mode}")
    time, position, velocity = loop.recorded(simulator.get_context())
    foot = leg_forward(GEOMETRY, position).point
    return Recording(params.circle, time, position, velocity, foot)


def write_recordings(
    scenario: ChairCircleScenario, options: RunOptions, recordings: dict[str, Recording]
) -> None:
    """Writes the log, if one is asked for; all modes have the same times.

    Raises:
        OutputError: the file cannot be written.
    """
    if options.log is None:
        return
    any_one = recordings[MODES[0]]
    signals: dict[str, tuple[Floats, str]] = {
        "position_desired": (any_one.planned.length, "m"),
        "velocity_desired": (any_one.planned.velocity, "m/s"),
        "foot_desired": (any_one.circle.motion(any_one.time).position, "m"),
    }
    for mode, recording in recordings.items():
        signals[f"{mode}.position"] = (recording.position, "m")
        signals[f"{mode}.velocity"] = (recording.velocity, "m/s")
        signals[f"{mode}.foot"] = (recording.foot, "m")
    write_experiment_log(options.log, "chair-circle", scenario, any_one.time, signals)
