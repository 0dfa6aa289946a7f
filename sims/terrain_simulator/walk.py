"""Walk one leg on the bench: a walking trot on the pedal, a flying trot on the treadmill.

The plate gives the foot its footholds, the slide carries a quarter of the body, and the drive of
the slide plays the other legs. Ground reaction forces stand beside the laws that bind them: over
whole strides their mean is the weight, within a stance their impulse is that of the gait's force.

| measured at 1 ms | trot 1.5 m/s, pedal | trot 2.75 m/s, treadmill |
|---|---|---|
| plate from its path | .056 mm, .0005 deg | .05 mm, .009 deg |
| mean force by weight | .9999 | 1.0000 |
| largest force | 923 N | 1190 N, at touchdown |
| hip from its gait | 1.6 mm | 3.0 mm |
| sliders, largest speed | 2.67 m/s | .4 m/s |
| real-time factor, nothing recorded | 2.7 | 2.5 |
"""

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context
from rich.console import Console

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.style import COLOURS
from parapod.diagrams.terrain_simulator.machine import TERRAIN_BENCH, make_terrain
from parapod.diagrams.terrain_simulator.scenario import BODIES, TerrainBenchScenario
from parapod.diagrams.terrain_simulator.view import TerrainRibbon
from parapod.sims.lab.experiment import LoopExperiment
from parapod.sims.lab.panel import Panel, Readout, Row
from parapod.sims.lab.run import Run, realtime_metric
from parapod.sims.lab.runner import make_viewer
from parapod.sims.output.figures import Figure, shade
from parapod.sims.output.results import Metric
from parapod.sims.terrain_simulator.live import LiveBench
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.ports import value_of
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.kinematics import jacobian, slider_rates
from parapod.systems.terrain_simulator.operator import BenchControls
from parapod.systems.terrain_simulator.ranges import holding_forces
from parapod.systems.terrain_simulator.walk import BenchWalk, WalkMotion, check_walk

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# Bounds of the plate's error and of the gaps in the loops of a bench as large as the paper's, and
# of the mean force [mm, um, -].
_PLATE_MM, _CLOSED_UM, _MEAN = 0.1, 20.0, 1e-3
# Share of the plate's error that sliders may make which give way, and instants that are looked
# at.
_YIELDING, _INSTANTS = 0.8, 1000
# Strides that pass before a walk counts as steady.
_SETTLING = 3
# Shortest period of a loop through three drives on one bus of 1 Mbit/s [s].
_SHORTEST = 0.005
# Longest period with which torques that are held between samples keep a foot calm [s].
_LONGEST = 0.001
# Share of the largest force from which on friction is computed: at touchdown next to none presses.
_PRESSED = 0.2
_SIGNALS = (
    "pose_desired",
    "share",
    "plate_motion",
    "foot_load",
    "load_estimated",
    "sliders.position",
    "sliders.velocity",
    "hip.position",
    "hip.velocity",
    "hip.force_command",
    "leg.position",
    "leg.torque_command",
    "truth.pose",
    "truth.foot_force",
    "truth.slider_force",
    "truth.loop_error",
)


class BenchExperiment[S, D](LoopExperiment[S, D]):
    """An experiment in which a leg walks on the bench."""

    machine = TERRAIN_BENCH

    def loop(self, scenario: S, **options: Any) -> ClosedLoop[Any]:
        """Builds the closed loop, in a scene with the terrain beside the bench."""
        return walking_loop(self.machine_scenario(scenario), **options)

    def structure(self, scenario: S) -> str:
        """See `LoopExperiment`; all of the bench but what it is reset to."""
        return self.machine.structure(self.machine_scenario(scenario))

    def scene(self, scenario: S) -> Meshcat:
        """A scene around the bench, seen from its near side."""
        x, z = self.machine_scenario(scenario).walk.hip
        return make_viewer(camera=(x + 1.1, -2.9, z + 0.35), target=(x, 0.0, 0.55 * z))

    def read_out(self, loop: ClosedLoop[Any], root_context: Context) -> Readout:
        """Pose, force and distance."""
        now = loop.readings(root_context, ("truth.pose", "truth.foot_force", "hip.position"))
        pose = value_of(loop.controller, "pose_desired", root_context)
        true = now["truth.pose"]() if "truth.pose" in now else np.full(3, np.nan)
        rows = [
            Row("x", 1e3 * pose[0], true=1e3 * float(true[0]), unit="mm", decimals=1),
            Row("z", 1e3 * pose[1], true=1e3 * float(true[1]), unit="mm", decimals=1),
            Row(
                "phi", float(np.degrees(pose[2])), true=float(np.degrees(true[2])), unit="deg",
                decimals=2,
            ),
            Row("hip", measured=1e3 * float(now["hip.position"]()[0]), unit="mm", decimals=1),
        ]  # fmt: skip
        if "truth.foot_force" in now:
            force = float(now["truth.foot_force"]()[1])
            rows.append(Row("ground on the foot", measured=force, unit="N", decimals=0))
        distances = [source for source in loop.sources if source.HasOutputPort("distance")]
        if distances:
            travelled = float(value_of(distances[0], "distance", root_context)[0])
            rows.append(Row("way of the body", measured=travelled, unit="m", decimals=2))
        share = float(value_of(loop.controller, "share", root_context)[0])
        return Readout("" if share > 0.99 else f"slowed down to {100.0 * share:.0f} %", rows)


class BenchWalking(BenchExperiment[TerrainBenchScenario, Run]):
    """Walks over the terrain of a scenario."""

    schema = TerrainBenchScenario
    backends = TERRAIN_BENCH.backends
    signals = _SIGNALS
    # Drives whose set values come every 10 ms give up at more than 2 m/s of a slider.
    on_devices = ("control.period=0.01", "gait.speed_m_s=0.8", "gait.frequency_Hz=1")
    takes = "10 s"
    advice = (
        "Move the plate with the sliders in the browser; choose a speed, and click a terrain to "
        "have the leg walk over it."
    )

    def check(self, scenario: TerrainBenchScenario) -> None:
        """Refuses a walk before anything moves.

        Raises:
            ScenarioError: settings that do not fit together, or an unusable leg.
            PathRefused: a limit of the bench, when, and the largest admissible speed.
            UnreachableFoot: the leg does not reach.
        """
        super().check(scenario)
        check_bench(scenario)
        check_stiffness(scenario)

    def duration(self, scenario: TerrainBenchScenario) -> float:
        """Until the leg has stood a while [s]."""
        return scenario.walk.duration + scenario.end

    def operated(
        self, scenario: TerrainBenchScenario, controls: Any, meshcat: Meshcat | None = None
    ) -> ClosedLoop[Any]:
        """The bench in a person's hands, its leg standing."""
        source = BenchControls(controls, scenario.walk, scenario.control.period)
        return ClosedLoop(TERRAIN_BENCH, scenario, sources=(source,), meshcat=meshcat, log=())

    def live(
        self, scenario: TerrainBenchScenario, panel: Panel, run: Run, console: Console
    ) -> Callable[[], str]:
        """Sliders move the plate, buttons have the leg walk."""
        return LiveBench(self, scenario, panel).obey

    def measure(self, scenario: TerrainBenchScenario, run: Run) -> Iterator[Metric]:
        """Errors of the plate, forces on the foot and what binds them."""
        walk = scenario.walk
        desired = walk.at(run.time)
        if "truth.pose" in run:
            yield from plate_metrics(run, desired, scenario.machine.geometry.size)
        speeds = slider_rates(scenario.machine.geometry, desired.pose[0], desired.pose[1])
        yield Metric(
            "peak_slider_speed_m_s",
            float(np.abs(speeds).max()),
            "m/s",
            scenario.machine.sliders.max_velocity_m_s,
            meaning="largest speed that the walk asks of a slider",
        )
        yield Metric(
            "least_share",
            float(run["share"][1:].min()),
            at_least=1.0,
            meaning="smallest share of the commanded speed that the guard admitted",
        )
        if scenario.backend in BODIES:
            yield from force_metrics(walk, run, desired)
            yield from leg_metrics(scenario, run, desired)
        yield realtime_metric(run)

    def draw(self, scenario: TerrainBenchScenario, run: Run) -> Iterator[Figure]:
        """Forces, plate and leg over some strides."""
        if scenario.backend in BODIES:
            yield Figure(
                "bench_walk",
                "A leg walks on the bench",
                "Above the ground's force on the foot with what the gait asks of it, dashed, and "
                "the plate's way; below the torques of the leg, and the forces of the sliders. "
                "Grey: the foot stands. Fig. 2 shows such forces without numbers.",
                partial(_draw, scenario, run),
                (8.0, 5.0),
            )


def check_bench(scenario: TerrainBenchScenario) -> None:
    """Refuses a walk that bench or leg cannot do; see `BenchWalking.check`."""
    period = scenario.control.period
    if scenario.backend in BODIES and period > _LONGEST:
        raise ScenarioError(
            f"control.period = {period:g} s is too long for a leg, whose foot would rattle on the "
            f"plate; with rigid bodies it is {_LONGEST:g} s at most",
            "control.period",
        )
    if scenario.backend == "hardware" and period < _SHORTEST:
        raise ScenarioError(
            f"control.period = {period:g} s is too short for the drives' bus; "
            f"on hardware it is {_SHORTEST:g} s at least",
            "control.period",
        )
    walk = scenario.walk
    check_walk(scenario.machine.geometry, walk, scenario.machine.sliders.limits)
    # A controller of the user's own has gains of its own.
    period = 0.0 if scenario.leg.controller else scenario.leg_period
    scenario.leg.under_test.check(walk, period)


def check_stiffness(scenario: TerrainBenchScenario) -> None:
    """Refuses sliders that the gait's force takes from their path by as much as the plate may be.

    The force in closed form predicts the plate's error of soft sliders within a tenth: .093 mm for
    .094 mm of a pedal's of 2 N/um, .108 mm for .110 mm of a treadmill's of 20 N/um.

    Raises:
        ScenarioError: names the key, and the admissible values.
    """
    machine, walk = scenario.machine, scenario.walk
    geometry, sliders = machine.geometry, machine.sliders
    motion = walk.at(np.linspace(0.0, walk.duration, _INSTANTS))
    pose, ahead = motion.pose[0], walk.hip[0] + motion.foot[0, :, 0] - motion.pose[0, :, 0]
    load = motion.force[:, np.newaxis] * np.stack(
        (0.0 * ahead, -1.0 + 0.0 * ahead, ahead), axis=-1
    )
    forces = holding_forces(geometry, machine.masses, pose, load)
    ways = np.einsum("nij,nj->ni", jacobian(geometry, pose), forces) / sliders.stiffness_N_um
    way = 1e-3 * float(np.hypot(*ways[:, :2].T).max())
    most = _YIELDING * geometry.size * _PLATE_MM
    if way > most:
        key, own = "machine.sliders.stiffness_N_um", sliders.stiffness_N_um
        raise ScenarioError(
            f"{key} = {own:g}: the leg takes the plate {way:.2g} mm from its path, and {most:.2g} "
            f"mm is tolerable; it must be at least {math.ceil(1e3 * own * way / most) / 1e3:g}",
            key,
        )


def walking_loop(
    scenario: TerrainBenchScenario, meshcat: Meshcat | None = None, **options: Any
) -> ClosedLoop[Any]:
    """Closed loop of a bench; in a scene the terrain goes by beside it."""
    if meshcat is not None and "sources" not in options:
        ribbon = TerrainRibbon(meshcat, scenario.walk)
        options["sources"] = (make_terrain(scenario), ribbon)
    return ClosedLoop(TERRAIN_BENCH, scenario, meshcat=meshcat, **options)


def plate_metrics(run: Run, desired: WalkMotion, size: float) -> Iterator[Metric]:
    """Errors of the plate, and how well the loops of a bench of a size are closed."""
    error = run["truth.pose"] - desired.pose[0]
    yield Metric(
        "plate_error_mm",
        1e3 * float(np.hypot(error[:, 0], error[:, 1]).max()),
        "mm",
        size * _PLATE_MM,
        meaning="largest error of the plate's middle",
    )
    yield Metric(
        "plate_angle_error_deg",
        float(np.degrees(np.abs(error[:, 2]).max())),
        "deg",
        meaning="largest error of the plate's angle",
    )
    yield Metric(
        "loop_error_um",
        1e6 * float(run["truth.loop_error"].max()),
        "um",
        size * _CLOSED_UM,
        meaning="largest gap in the bench's closed loops",
    )


def force_metrics(walk: BenchWalk, run: Run, desired: WalkMotion) -> Iterator[Metric]:
    """Forces of the ground on the foot, beside the laws that bind them."""
    along, upwards = run["truth.foot_force"].T
    steady = steady_part(walk, run.time)
    if steady.any():
        yield Metric(
            "mean_force_ratio",
            float(upwards[steady].mean()) / walk.support.weight,
            bound=1.0 + _MEAN,
            at_least=1.0 - _MEAN,
            meaning="ratio of the mean force upwards to the weight, over whole strides",
        )
        meant = desired.force[steady]
        yield Metric(
            "impulse_ratio",
            float(upwards[steady & desired.stance].sum() / meant.sum()),
            meaning="ratio of the stances' impulse to that of the gait's force",
        )
    yield Metric(
        "peak_force_N", float(upwards.max()), "N", meaning="largest force of the ground upwards"
    )
    pressed = upwards > _PRESSED * walk.support.peak
    yield Metric(
        "friction_ratio",
        float(np.abs(along[pressed] / upwards[pressed]).max()),
        meaning="largest force along by the force upwards, where the foot presses",
    )
    reported = run["foot_load"][:, 1] + upwards
    yield Metric(
        "cell_error_N",
        float(np.sqrt(np.mean(reported[desired.stance] ** 2))),
        "N",
        meaning="error of the force cells in stance, root mean square, their delay included",
    )
    guessed = run["load_estimated"][:, 1] + upwards
    yield Metric(
        "current_error_N",
        float(np.sqrt(np.mean(guessed[desired.stance] ** 2))),
        "N",
        meaning="error of the load estimated from the sliders' currents",
    )


def leg_metrics(scenario: TerrainBenchScenario, run: Run, desired: WalkMotion) -> Iterator[Metric]:
    """Errors of hip and foot, and the largest torque of the leg."""
    walk, leg = scenario.walk, scenario.leg.under_test
    height = run["hip.position"][:, 0] - walk.hip[1] - desired.bounce[0]
    yield Metric(
        "hip_error_mm",
        1e3 * float(np.abs(height).max()),
        "mm",
        meaning="largest error of the hip's height",
    )
    places = leg.places(run["leg.position"], desired.pose[0, :, 2])
    swings = ~desired.stance
    off = np.linalg.norm(places - desired.foot[0], axis=-1)
    for name, which in (("swing", swings), ("stance", desired.stance)):
        yield Metric(
            f"foot_{name}_error_mm",
            1e3 * float(off[which].max()),
            "mm",
            meaning=f"largest error of the foot in {name}",
        )
    torque = np.abs(run["leg.torque_command"]).max(axis=0)
    yield Metric(
        "torque_share",
        float((torque / np.array(leg.max_torque)).max()),
        meaning="largest share of its drive's torque that a joint needs",
    )


def steady_part(walk: BenchWalk, time: Array) -> NDArray[np.bool_]:
    """Times of whole strides of a walk that has become steady; none if it is too short."""
    first, last = walk.steady
    half = 0.5 * float(np.median(np.diff(time)))
    return (time >= first + _SETTLING * walk.period - half) & (time < last - half)


def _draw(scenario: TerrainBenchScenario, run: Run, canvas: "Canvas") -> None:
    axes: Any = canvas.subplots(2, 2, sharex=True)
    desired = scenario.walk.at(run.time)
    for plot in axes.ravel():
        shade(plot, run.time, desired.stance, color="0.5", alpha=0.12, lw=0)
    for i, name in enumerate(("along", "upwards")):
        force = run["truth.foot_force"][:, i]
        axes[0, 0].plot(run.time, force, color=COLOURS[1 - i], lw=0.9, label=name)
    axes[0, 0].plot(run.time, desired.force, "--", color="0.3", lw=0.8)
    axes[0, 0].set(
        ylabel="ground on the foot [N]", ylim=(-300.0, 1.35 * scenario.walk.support.peak)
    )
    for i, name in enumerate(("along", "upwards")):
        way = run["truth.pose"][:, i]
        axes[0, 1].plot(run.time, 1e3 * (way - way[0]), color=COLOURS[i], label=name)
    axes[0, 1].set(ylabel="way of the plate [mm]")
    for i, name in enumerate(scenario.leg.under_test.names):
        torque = run["leg.torque_command"][:, i]
        axes[1, 0].plot(run.time, torque, color=COLOURS[i % 7], lw=0.9, label=name)
    axes[1, 0].set(ylabel="torques of the leg [N m]")
    for i, force in enumerate(run["truth.slider_force"].T):
        axes[1, 1].plot(run.time, force, color=COLOURS[i], lw=0.9, label=f"slider {i + 1}")
    axes[1, 1].set(ylabel="forces of the drives [N]")
    for plot in axes.ravel():
        plot.legend(ncols=3, fontsize=7, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    for plot in axes[1]:
        plot.set_xlabel("time [s]")
