"""Try another leg on the bench: look at it, let it stand, step up, and jump.

It takes a URDF of a planar leg, with the names of its links and joints. First the leg's mass, its
joints' limits and its reach over the plate are printed; then it steps onto a step that the plate
plays, and jumps by 0.3 m, which takes Table 1's vertical speed.

The walking chair's leg on the bench, measured at 1 ms:

| | level | 10 deg up, rear leg | 10 deg down, front leg |
|---|---|---|---|
| the leg's loops, the bench's [um] | .13, .62 | .13, .78 | .13, .54 |
| foot in stance, in swing [mm] | .18, .11 | .17, .12 | .17, .12 |
| force of the ground beside the gait's, rms by peak [%] | 2.0 | 2.0 | 2.0 |
| force along by upwards, where it presses | .08 | .15 | .14 |

Screws that yield by 1 um for a newton make most of the error in stance. Down the slope the
ground's forces differ from those over a slope in the world by 1.3 %, the hip's heights by .07 mm.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.style import COLOURS
from parapod.diagrams.terrain_simulator.design import BenchDesign
from parapod.diagrams.terrain_simulator.leg import make_leg_model
from parapod.diagrams.terrain_simulator.machine import TERRAIN_BENCH, make_terrain
from parapod.diagrams.terrain_simulator.scenario import (
    BenchControlScenario,
    BenchPlantScenario,
    ChairLegScenario,
    GaitScenario,
    HipScenario,
    LegScenario,
    PlaceScenario,
    TerrainBenchScenario,
)
from parapod.diagrams.terrain_simulator.terrains import Slope, Step
from parapod.sims.lab.run import Run, realtime_metric
from parapod.sims.lab.runner import Runner
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.sims.terrain_simulator.courses import place_on
from parapod.sims.terrain_simulator.walk import (
    BenchExperiment,
    BenchWalking,
    check_bench,
)
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.jump import SquatJump
from parapod.systems.terrain_simulator.leg import LegModel, UnreachableFoot
from parapod.systems.terrain_simulator.reference import Task
from parapod.systems.terrain_simulator.walk import BenchWalk
from parapod.systems.walking_chair.geometry import LEG_COUNT
from parapod.systems.walking_chair.masses import ChairMasses, Passenger

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# Bounds: reach left, by the height of the hip, error of the jump's height by that, and weight
# while standing [-].
_REACH, _HEIGHT, _WEIGHT = 1.0 / 61.0, 1.0 / 6.0, 1e-3
# Share of its distance from the hip by which a foot is tried farther away, and the steps of that.
_FURTHER = 0.4
_STEP = _FURTHER / 2**12
_PLACES = 40  # places of the foot on its way that give its reach
_TITLES = {"step": "step", "jump": "jump", "chair": "the walking chair's leg"}
TRIES = tuple(_TITLES)
# Bound of the foot of the chair's leg, whose screws yield [mm].
_CHAIR_MM = 0.5
# Ground force at which a foot has left the plate, or has landed [N], and the end of a run in which
# it stands [s].
_TOUCH, _STANDS = 5.0, 0.2
_SETTLES = 0.6  # time for which it stands after the step [s]
_EDGE_M = 0.25  # edge of the step, from the beginning
# Way by which a leg is drawn up before it lands [m].
_DRAWN_UP = 0.04
# Way that is left until the foot of the chair's leg would stand flat [mm].
_MARGIN = 5.0
_JUMP_Z = 0.30  # height of the plate from which is jumped [m]


def _foreign() -> LegScenario:
    """A leg with three joints that another hand has described."""
    return LegScenario(
        urdf="package://parapod/terrain_simulator/digitigrade.urdf",
        hip_frame="mount",
        foot_frame="toe",
        foot_radius_mm=22.0,
        joints=["HFE", "KFE", "AFE"],
        posture_deg=[43.0, -77.0, 52.0],
        max_torque=[220.0, 220.0, 160.0],
    )


@dataclass
class BenchLegScenario(Schema):
    """A leg that is tried, and what it does.

    Attributes:
        backend: plant: "multibody", rigid bodies with contact.
        seed: seed of the noise of the force cells.
        machine: the bench; see `BenchDesign`.
        leg: the leg, see `LegScenario`; by default one of three joints, not the bench's own.
        mass_kg: mass that the slide has with the leg [kg].
        hip_mm: height of the hip above the plate as it stands [mm].
        step_mm: height of the step [mm].
        strides: strides in which the leg walks onto it, and on.
        jump_mm: height of the jump [mm].
        squat_mm: way by which the hip sinks before it jumps [mm].
        stretch_mm: rise of the hip at take-off above its height when it stands [mm].
        time_step: step of the rigid bodies, and period of the controllers [s]; with a longer one
            the foot rattles on the plate.
        accuracy: accuracy of the rigid bodies, as `plant.accuracy` of bench-walk [m, rad]; null:
            they take steps of `time_step`.
        tries: tasks in their order: "step", "jump", and "chair", which is a walk of the leg of the
            walking chair.
    """

    backend: str = choice("multibody", ("multibody",))
    seed: int = quantity(0, 0, 2**31 - 1)
    machine: BenchDesign = field(default_factory=BenchDesign)
    leg: LegScenario = field(default_factory=_foreign)
    mass_kg: float = quantity(30.0, 0.1, 1000.0)
    hip_mm: float = quantity(610.0, 50.0, 1200.0)
    step_mm: float = quantity(80.0, -300.0, 300.0)
    strides: int = quantity(3, 1, 100)
    jump_mm: float = quantity(300.0, 10.0, 1000.0)
    squat_mm: float = quantity(100.0, 10.0, 500.0)
    stretch_mm: float = quantity(80.0, 10.0, 500.0)
    time_step: float = quantity(1e-3, 2.5e-4, 1e-3)
    accuracy: float | None = quantity(None, 1e-9, 1e-1)
    tries: list[str] = field(default_factory=lambda: list(TRIES))

    @property
    def walk(self) -> TerrainBenchScenario:
        """The step."""
        return replace(
            TerrainBenchScenario(),
            seed=self.seed,
            end=_SETTLES,
            plant=BenchPlantScenario(self.time_step, self.accuracy),
            control=BenchControlScenario(self.time_step),
            machine=self.machine,
            leg=self.leg,
            hip=HipScenario(mass_kg=self.mass_kg),
            terrain=Step(rise_mm=self.step_mm, at_m=_EDGE_M),
            place=PlaceScenario(*place_on(self.machine, 513.0, 270.0), self.hip_mm),
            gait=GaitScenario(
                speed_m_s=0.3,
                frequency_Hz=1.5,
                ramp=None,
                strides=self.strides,
                run_up=0,
                clearance_mm=60.0,
            ),
        )

    @property
    def jump(self) -> TerrainBenchScenario:
        """The bench for the jump: the drive of the slide plays no other legs."""
        alone = HipScenario(mass_kg=self.mass_kg, stiffness_N_m=0.0, damping_Ns_m=0.0)
        place = PlaceScenario(*place_on(self.machine, 513.0, 1e3 * _JUMP_Z), self.hip_mm)
        return replace(self.walk, hip=alone, place=place)

    @property
    def task(self) -> SquatJump:
        """The jump.

        Raises:
            ScenarioError: heights that do not follow upon one another.
        """
        bench, hip = self.jump.walk.path, 1e-3 * self.hip_mm
        stretched = hip + 1e-3 * self.stretch_mm
        try:
            return SquatJump(
                (bench.x_c, bench.z_c),
                self.mass_kg,
                standing=hip,
                squatting=hip - 1e-3 * self.squat_mm,
                stretched=stretched,
                landing=stretched - _DRAWN_UP,
                height=1e-3 * self.jump_mm,
                foot_radius=1e-3 * self.leg.foot_radius_mm,
            )
        except ValueError as error:
            raise ScenarioError(f"the jump: {error}", "squat_mm") from None


@dataclass(frozen=True)
class LegTest:
    """Runs of a leg.

    Attributes:
        runs: runs by the name of the trial.
    """

    runs: dict[str, Run]

    @property
    def run(self) -> Run:
        """The one that is watched: the first."""
        return next(iter(self.runs.values()))


class _Jump(BenchWalking):
    """The jump of a scenario's leg."""

    def __init__(self, name: str, task: SquatJump):
        super().__init__(name)
        self._task = task

    def duration(self, scenario: TerrainBenchScenario) -> float:
        """Until the leg has stood a while [s]."""
        return self._task.duration + _STANDS

    def loop(self, scenario: TerrainBenchScenario, **options: Any) -> ClosedLoop[Any]:
        """Builds the closed loop."""
        sources = (make_terrain(scenario, self._task),)
        return ClosedLoop(TERRAIN_BENCH, scenario, sources=sources, **options)


class BenchLeg(BenchExperiment[BenchLegScenario, LegTest]):
    """Tries a leg."""

    schema = BenchLegScenario
    backends = ("multibody",)
    takes = "10 s"

    def machine_scenario(self, scenario: BenchLegScenario) -> TerrainBenchScenario:
        """The step."""
        return scenario.walk

    def check(self, scenario: BenchLegScenario) -> None:
        """Refuses a leg before anything moves.

        Raises:
            ScenarioError: an unknown file, link or joint, or a leg that is too heavy.
            UnreachableFoot: it does not reach where it is to tread, or jump from.
            PathRefused: the bench cannot play the step.
        """
        if scenario.leg.kind != "urdf":
            raise ScenarioError(
                f"leg.kind = '{scenario.leg.kind}' cannot be looked at, only a leg of a URDF; "
                "the walking chair's is tried as 'chair'",
                "leg.kind",
            )
        if not scenario.tries or not set(scenario.tries) <= set(TRIES):
            names = ", ".join(TRIES)
            raise ScenarioError(f"tries must name some of {names}", "tries")
        check_bench(scenario.walk)
        task, leg = scenario.task, make_leg_model(scenario.leg.description)
        leg.follow(task.at(np.linspace(0.0, task.duration, _PLACES)).foot[0])

    def duration(self, scenario: BenchLegScenario) -> float:
        """End of the step [s]."""
        return scenario.walk.walk.duration + scenario.walk.end

    def run(self, scenario: BenchLegScenario, runner: Runner) -> LegTest:
        """Steps, and jumps."""
        tasks: dict[str, tuple[BenchWalking, TerrainBenchScenario]] = {
            "step": (BenchWalking(self.name), scenario.walk),
            "jump": (_Jump(self.name, scenario.task), scenario.jump),
        }
        runs: dict[str, Run] = {}
        for name in dict.fromkeys(scenario.tries):
            runner.name = f"{self.name}, {name}"
            # The chair is imported only if its leg is asked for.
            how, what = tasks.get(name) or (BenchWalking(self.name), chair_leg_scenario())
            runs[name] = how.run_loop(what, runner, watched=not runs)
        return LegTest(runs)

    def measure(self, scenario: BenchLegScenario, data: LegTest) -> Iterator[Metric]:
        """Numbers of the leg alone, of standing, of the step and of the jump."""
        leg = make_leg_model(scenario.leg.description)
        yield Metric("leg_mass_kg", leg.mass, "kg", meaning="mass of the leg")
        yield from _reach(scenario, leg, data)
        for name, measured in (
            ("step", _step_metrics),
            ("jump", _jump_metrics),
            ("chair", _chair_metrics),
        ):
            if name in data.runs:
                yield from measured(scenario, data.runs[name])
        yield realtime_metric(*data.runs.values())

    def draw(self, scenario: BenchLegScenario, data: LegTest) -> Iterator[Figure]:
        """Height of the hip and force of the ground, on the step and in the jump."""
        yield Figure(
            "bench_leg",
            "A leg from another source",
            "What is tried, from the left. Above the height of the hip over where it stands, "
            "below the ground's force upwards on the foot; dashed what is asked for.",
            partial(_draw, scenario, data),
            (8.0, 4.2),
        )


def reach_margin(leg: LegModel, feet: Array) -> float:
    """Way by which the foot could go further from the hip wherever it is [m].

    Args:
        leg: the leg.
        feet: (k, 2) x, z from the hip [m].

    Raises:
        UnreachableFoot: one of them that cannot be reached itself.
    """
    least = _FURTHER * float(np.linalg.norm(feet, axis=1).max())
    for foot in feet:
        near, step = leg.reach(foot), _STEP * float(np.linalg.norm(foot))
        # How much further than the others it could go need not be known.
        low, high = 0, math.ceil(least / step)
        if _reaches(leg, (1.0 + high * _STEP) * foot, near):
            continue
        while high - low > 1:
            middle = (low + high) // 2
            is_near = _reaches(leg, (1.0 + middle * _STEP) * foot, near)
            low, high = (middle, high) if is_near else (low, middle)
        least = low * step
    return least


def _reaches(leg: LegModel, foot: Array, near: Array) -> bool:
    try:
        leg.reach(foot, near)
    except UnreachableFoot:
        return False
    return True


def _reach(scenario: BenchLegScenario, leg: LegModel, data: LegTest) -> Iterator[Metric]:
    walk = scenario.walk.walk
    feet = walk.at(np.linspace(walk.lift_off, walk.landing, _PLACES)).foot[0]
    yield Metric(
        "reach_margin_mm",
        1e3 * reach_margin(leg, feet),
        "mm",
        at_least=_REACH * scenario.hip_mm,
        meaning="smallest reserve of the leg's reach on the foot's way",
    )
    low, high = leg.limits
    own = [run["leg.position"] for name, run in data.runs.items() if name != "chair"]
    if not own:
        return
    positions = np.concatenate(own)
    stroke_left = np.minimum(positions - low, high - positions).min()
    yield Metric(
        "joint_margin_deg",
        float(np.degrees(stroke_left)),
        "deg",
        at_least=0.0,
        meaning="smallest distance of a joint from its limits",
    )


def _step_metrics(scenario: BenchLegScenario, run: Run) -> Iterator[Metric]:
    walk = scenario.walk.walk
    yield _standing("standing_force_ratio", run, walk, "standing after the step")
    height = run["hip.position"][:, 0] - walk.at(run.time).bounce[0] - walk.hip[1]
    yield Metric(
        "hip_error_mm",
        1e3 * float(np.abs(height).max()),
        "mm",
        meaning="largest error of the hip's height on the step",
    )


def _standing(key: str, run: Run, walk: BenchWalk, when: str) -> Metric:
    """Weight that ground and slide carry at the end of a run, where all stands."""
    stands = run.time > run.time[-1] - _STANDS
    carried = run["truth.foot_force"][:, 1] + run["hip.force_command"][:, 0]
    return Metric(
        key,
        float(carried[stands].mean()) / walk.support.weight,
        bound=1.0 + _WEIGHT,
        at_least=1.0 - _WEIGHT,
        meaning=f"ratio of the force of ground and slide drive to the weight, {when}",
    )


def _jump_metrics(scenario: BenchLegScenario, run: Run) -> Iterator[Metric]:
    task, upwards = scenario.task, run["truth.foot_force"][:, 1]
    pushes = run.time > task.instants[1]
    touchdowns = np.flatnonzero(pushes & (upwards < _TOUCH))
    if not touchdowns.size:
        yield Metric(
            "takeoff_speed_m_s",
            np.nan,
            "m/s",
            meaning="speed of the hip at take-off",
            undefined="the foot did not leave the plate",
        )
        return
    off = int(touchdowns[0])
    speed = float(run["hip.velocity"][off, 0])
    height = run["hip.position"][:, 0]
    yield Metric(
        "takeoff_speed_m_s",
        speed,
        "m/s",
        paper=2.5,
        meaning="speed of the hip at take-off; "
        f"{scenario.jump_mm:g} mm need {task.takeoff_speed:.3f} m/s; "
        "the paper's is the plate's vertical speed",
    )
    rise = float(height[off:].max() - task.hip[1] - (task.stretched - task.standing))
    yield Metric(
        "jump_error_mm",
        1e3 * rise - scenario.jump_mm,
        "mm",
        _HEIGHT * scenario.jump_mm,
        meaning="error of the jump's height above the stretched leg",
    )
    lands = np.flatnonzero((run.time > run.time[off] + 0.5 * task.flight) & (upwards > _TOUCH))
    peak = float(upwards[lands[0] :].max()) if lands.size else np.nan
    meaning, undefined = "largest force of the ground at the landing", "the foot did not land"
    yield Metric("landing_peak_N", peak, "N", meaning=meaning, undefined=undefined)


def _chair_metrics(scenario: BenchLegScenario, run: Run) -> Iterator[Metric]:
    walked = chair_leg_scenario()
    walk, leg = walked.walk, walked.leg.under_test
    desired = walk.at(run.time)
    yield _standing("chair_force_ratio", run, walk, "the walking chair's leg, standing at last")
    places = leg.places(run["leg.position"], desired.pose[0, :, 2])
    yield Metric(
        "chair_foot_error_mm",
        1e3 * float(np.linalg.norm(places - desired.foot[0], axis=-1).max()),
        "mm",
        _CHAIR_MM,
        meaning="largest error of the foot of the walking chair's leg",
    )


def _draw(scenario: BenchLegScenario, data: LegTest, canvas: "Canvas") -> None:
    tasks: dict[str, Task] = {"step": scenario.walk.walk, "jump": scenario.task}
    if "chair" in data.runs:
        tasks["chair"] = chair_leg_scenario().walk
    axes: Any = canvas.subplots(2, len(data.runs), sharex="col", squeeze=False)
    for i, (name, run) in enumerate(data.runs.items()):
        task = tasks[name]
        desired = task.at(run.time)
        height = 1e3 * (run["hip.position"][:, 0] - task.hip[1])
        axes[0, i].plot(run.time, height, color=COLOURS[0])
        axes[0, i].plot(run.time, 1e3 * desired.bounce[0], "--", color="0.3", lw=0.8)
        axes[1, i].plot(run.time, run["truth.foot_force"][:, 1], color=COLOURS[1], lw=0.9)
        axes[1, i].plot(run.time, desired.force, "--", color="0.3", lw=0.8)
        axes[1, i].set_ylim(-100.0, 1.6 * float(desired.force.max()))
        axes[1, i].set_xlabel("time [s]")
        axes[0, i].set(ylabel="hip [mm]", title=_TITLES[name])
        axes[1, i].set(ylabel="ground on the foot [N]")


def chair_leg_scenario(slope_deg: float = 0.0) -> TerrainBenchScenario:
    """A slow walk of the chair's leg on the pedal, with a quarter of chair and passenger on it.

    Steps of 80 mm at 0.06 m/s, little slower than screws of 80 mm/s let it. The leg is a front leg
    of the chair, a rear one uphill. Its foot treads ahead of where it would be flat, or behind it,
    and so on the edge of E_2 and E_3: on the corner E_1 alone all load would be the UP branch's,
    and the 520 N of a walk on two legs by turns are more than it bears. So are the loads of a
    front leg uphill, and of a rear one downhill.

    Args:
        slope_deg: slope of the ground, positive uphill [deg].
    """
    mass = (ChairMasses().total + Passenger().mass) / LEG_COUNT
    gait = GaitScenario(
        speed_m_s=0.06,
        frequency_Hz=0.75,
        duty=0.6,
        ramp=0.3,
        strides=2,
        run_up=0,
        clearance_mm=8.0,
        load="even",
    )
    stance = 1e3 * gait.duty * gait.speed_m_s / gait.frequency_Hz
    flat = 0.5 * stance + _MARGIN
    is_rear = slope_deg > 0.0
    chair = ChairLegScenario(is_rear, slope_deg, flat if is_rear else -flat)
    scenario = TerrainBenchScenario(
        gait=gait,
        place=PlaceScenario(hip_mm=chair.height_mm),
        leg=LegScenario(kind="walking_chair", chair=chair),
        hip=HipScenario(mass_kg=mass),
    )
    if slope_deg:
        scenario.terrain = Slope(slope_deg)
    return scenario
