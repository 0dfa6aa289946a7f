"""Lead the frame of a mechanism along a way, or on a tour of all its coordinates.

The mechanism is any closed loop that a model file describes. Without waypoints its frame goes
along each coordinate that its motors can set, both ways, as far as motors, limits and singular
positions let it. Rigid bodies, whose loops constraints close, are led by the numerical inverse.

| measured at 1 ms, half as fast as may be | 3-RPS | 6-UPS | delta |
|---|---|---|---|
| frame from its way | .13 mm, .024 deg | .21 mm, .025 deg | .10 mm |
| largest gap of a loop | .21 um | 1.7 um | .07 um |
| real-time factor, nothing recorded | 3.8 | 2.8 | 2.8 |
"""

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context

from parapod.diagrams.any_mechanism.controller import make_controls
from parapod.diagrams.any_mechanism.machine import MECHANISM
from parapod.diagrams.any_mechanism.ports import PART
from parapod.diagrams.any_mechanism.scenario import MULTIBODY, MechanismScenario
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.sims.lab.experiment import LoopExperiment
from parapod.sims.lab.panel import Readout, Row
from parapod.sims.lab.run import Run, realtime_metric
from parapod.sims.lab.runner import Runner, make_viewer
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.ports import value_of
from parapod.systems.mechanism.coordinates import PARTS, part_unit
from parapod.systems.mechanism.statics import motor_forces

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

type Floats = NDArray[np.float64]

# Bounds of the frame's errors: a share of the mechanism's size [-], and an angle [rad].
_ERROR, _TURNED = 2e-3, np.radians(0.2)
# Bound of the gaps in loops, by the mechanism's size [-].
_CLOSED = 1e-4
# Mass of a link by that of the heaviest below which its loops are soft [-].
_LIGHT = 1e-3
# Least distance from a singular position on the way, by that at home [-].
_NEAR = 0.1
# Instants of a way of which one is looked at for forces.
_EVERY = 10
# Directions from the camera to the mechanism, by its size [-].
_AWAY = np.array([1.7, -2.0, 1.0])


class MechanismExperiment[S](LoopExperiment[S, Run]):
    """An experiment with a mechanism, whose bodies are those of any file."""

    machine = MECHANISM

    def loop(self, scenario: S, **options: Any) -> ClosedLoop[Any]:
        """Builds the closed loop of the mechanism."""
        return ClosedLoop(MECHANISM, self.machine_scenario(scenario), **options)

    def structure(self, scenario: S) -> str:
        """See `LoopExperiment`."""
        return MECHANISM.structure(self.machine_scenario(scenario))

    def run(self, scenario: S, runner: Runner) -> Run:
        """See `LoopExperiment`.

        Raises:
            ParapodError: bodies that Drake cannot simulate with these steps.
        """
        settings = self.machine_scenario(scenario)
        try:
            return super().run(scenario, runner)
        except RuntimeError as error:
            if settings.backend != MULTIBODY:
                raise
            reason, *_ = str(error).partition(". ")
            raise ParapodError(
                f"the bodies of {settings.machine.path.name} cannot be simulated so: {reason}; "
                "plant.time_step may be too long, or the backend must be kinematic"
            ) from error

    def scene(self, scenario: S) -> Meshcat:
        """A scene around the mechanism."""
        built = self.machine_scenario(scenario).machine.built
        mechanism, context = built.mechanism, built.mechanism.plant.CreateDefaultContext()
        mechanism.plant.SetPositions(context, built.q)
        poses: Any = mechanism.plant.get_body_poses_output_port().Eval(context)
        places = np.array([pose.translation() for pose in poses[1:]])
        middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
        return make_viewer(middle + _AWAY * mechanism.size, middle)


class MechanismTrack(MechanismExperiment[MechanismScenario]):
    """Leads a frame and looks how far it is from where it should be."""

    schema = MechanismScenario
    backends = MECHANISM.backends
    signals = (
        *("pose_desired_state", "motor_desired_state", "pose_estimated"),
        *(f"{PART}.position", f"{PART}.velocity"),
        *("truth.pose", "truth.base", "truth.motor_force", "truth.loop_error"),
    )
    takes = "10 s"
    advice = "Move the frame with the sliders in the browser; with Ctrl held, drag any body."

    def check(self, scenario: MechanismScenario) -> None:
        """Refuses a way that the motors cannot make, and when.

        Raises:
            ScenarioError: a pose that the frame does not get to, or motors that are too slow or
                too weak.
        """
        super().check(scenario)
        way, built = scenario.way, scenario.machine.built
        motors, acceleration = built.motors, scenario.machine.drives.acceleration
        steps = range(0, len(way.times), _EVERY)
        held = [motor_forces(built.mechanism, way.positions[i]).forces for i in steps]
        for word, times, share, key in (
            ("fast", way.times, np.abs(way.rates) / motors.velocities, "track"),
            ("quick", way.times, np.abs(way.accelerations) / acceleration, "track"),
            ("strong", way.times[::_EVERY], np.abs(held) / motors.forces, "machine.max_force"),
        ):
            instant, motor = np.unravel_index(int(np.argmax(share)), share.shape)
            if not share.max() <= 1.0:
                raise ScenarioError(
                    f"{key}: {motors.names[motor]} would have to be {share.max():.3g} times as "
                    f"{word} as it is, at {times[instant]:.2f} s",
                    key,
                )

    def duration(self, scenario: MechanismScenario) -> float:
        """Until the frame has stood a while [s]."""
        return scenario.way.duration

    def operated(
        self, scenario: MechanismScenario, controls: Any, meshcat: Meshcat | None = None
    ) -> ClosedLoop[Any]:
        """The mechanism in a person's hands."""
        source = make_controls(scenario, controls)
        return ClosedLoop(MECHANISM, scenario, sources=(source,), meshcat=meshcat, log=())

    def read_out(self, loop: ClosedLoop[Any], root_context: Context) -> Readout:
        """Coordinates of the frame, as they are asked for and as they are."""
        built = loop.scenario.machine.built
        now = loop.readings(root_context, ("truth.pose",))
        goals = [
            value_of(source, "pose_desired_state", root_context)
            for source in loop.sources
            if source.HasOutputPort("pose_desired_state")
        ]
        measured = value_of(loop.controller, "pose_estimated", root_context)
        true = now["truth.pose"]() if "truth.pose" in now else np.full(6, np.nan)
        rows = []
        for i, part in enumerate(built.parts):
            unit, factor = part_unit(part)
            desired = factor * float(goals[0][i]) if goals else None
            numbers = (desired, factor * float(measured[part]), factor * float(true[part]))
            rows.append(Row(PARTS[part], *numbers, unit=unit, decimals=1 if part < 3 else 2))
        is_followed = bool(
            np.isfinite(value_of(loop.controller, "motor_desired_state", root_context)).all()
        )
        return Readout("" if is_followed else "the frame cannot get there", rows)

    def measure(self, scenario: MechanismScenario, run: Run) -> Iterator[Metric]:
        """Errors of the frame, what the motors do, and gaps of the loops."""
        built = scenario.machine.built
        size, motors = built.mechanism.size, built.motors
        yield from error_metrics(scenario, run, "pose_estimated", "encoder_error", "by encoders")
        if "truth.pose" in run:
            bounds = 1e3 * _ERROR * size, float(np.degrees(_TURNED))
            yield from error_metrics(scenario, run, "truth.pose", "error", "as it is", bounds)
            gaps = run["truth.loop_error"]
            yield Metric(
                "loop_error_um",
                1e6 * float(gaps[:, 0].max()),
                "um",
                1e6 * _CLOSED * size,
                meaning="largest gap in a closed loop",
            )
        speeds = np.abs(scenario.way.rates) / motors.velocities
        yield Metric(
            "speed_share",
            float(speeds.max()),
            bound=1.0,
            meaning="largest share of its speed that the way asks of a motor",
        )
        held = [built.mechanism.dexterity(q, built.frame).held for q in scenario.way.positions]
        home = built.mechanism.dexterity(built.q, built.frame).held
        yield Metric(
            "least_held",
            min(held) / home,
            at_least=_NEAR,
            meaning="smallest distance from a singular position on the way, by that at home",
        )
        if "truth.motor_force" in run:
            yield from force_metrics(scenario, run)
        yield realtime_metric(run)

    def note(self, scenario: MechanismScenario, run: Run) -> Iterator[str]:
        """Coordinates in which the frame is led, and advice where loops are too soft."""
        built = scenario.machine.built
        names = ", ".join(PARTS[part] for part in built.parts)
        yield f"{built.frame} is led along {names}"
        yield from advice_on_loops(scenario, run)

    def draw(self, scenario: MechanismScenario, run: Run) -> Iterator[Figure]:
        """Way, errors and forces over time."""
        if "truth.pose" in run:
            yield Figure(
                "mechanism_track",
                "A frame led along a way",
                "Coordinates of the frame from where it is at home, their errors, and the forces "
                "of the motors.",
                partial(_draw, scenario, run),
                (7.0, 6.4),
            )


def advice_on_loops(scenario: MechanismScenario, run: Run) -> Iterator[str]:
    """Advice where loops of rigid bodies are farther open than they may be.

    Args:
        scenario: the scenario.
        run: its run.
    """
    mechanism = scenario.machine.built.mechanism
    if "truth.loop_error" not in run or scenario.backend != MULTIBODY:
        return
    if run["truth.loop_error"][:, 0].max() <= _CLOSED * mechanism.size:
        return
    plant = mechanism.plant
    bodies = [plant.get_body(BodyIndex(i)) for i in range(1, plant.num_bodies())]
    weights = {body.name(): body.default_mass() for body in bodies if body.default_mass() > 0.0}
    advice = f"the loops are soft: plant.time_step below {scenario.plant.time_step:g} s is stiffer"
    if weights and min(weights.values()) < _LIGHT * max(weights.values()):
        light = min(weights, key=lambda name: weights[name])
        advice += f", and machine.least_mass_kg, since {light} weighs {weights[light]:.2g} kg only"
    yield advice


def error_metrics(
    scenario: MechanismScenario,
    run: Run,
    signal: str,
    name: str,
    by: str,
    bounds: tuple[float | None, float | None] = (None, None),
) -> Iterator[Metric]:
    """Largest errors of the frame's place and attitude.

    Args:
        scenario: the scenario.
        run: its run.
        signal: pose (6) that is compared with the way.
        name: name of the metrics, before their unit.
        by: origin of the pose, for people.
        bounds: those of the place [mm] and of the attitude [deg].
    """
    built = scenario.machine.built
    error = frame_error(scenario, run, signal)
    for unit, of, bound in zip(("mm", "deg"), ("place", "attitude"), bounds, strict=True):
        kinds = [part_unit(part) for part in built.parts]
        columns = [i for i, (each, _) in enumerate(kinds) if each == unit]
        if columns:
            factor = kinds[columns[0]][1]
            yield Metric(
                f"{name}_{unit}",
                factor * float(np.abs(error[:, columns]).max()),
                unit,
                bound,
                meaning=f"largest error of a coordinate of the frame's {of}, {by}",
            )


def frame_error(scenario: MechanismScenario, run: Run, signal: str = "truth.pose") -> Floats:
    """Errors (n, k) of the frame's coordinates [m, rad]: where it is, less where it should be."""
    built = scenario.machine.built
    desired = scenario.way.path.vector_values(run.time.tolist()).T
    error: Floats = run[signal][:, list(built.parts)] - desired
    angles = [i for i, part in enumerate(built.parts) if part >= 3]
    error[:, angles] = np.remainder(error[:, angles] + np.pi, 2.0 * np.pi) - np.pi
    return error


def force_metrics(scenario: MechanismScenario, run: Run) -> Iterator[Metric]:
    """Largest forces of the motors, by their limits where they have some."""
    motors, forces = scenario.machine.built.motors, np.abs(run["truth.motor_force"][1:])
    for unit, per, name in (("m", "N", "peak_force_N"), ("rad", "N m", "peak_torque_Nm")):
        columns = [i for i, each in enumerate(motors.units) if each == unit]
        if columns:
            limits = np.array(motors.forces)[columns]
            bound = float(limits.min())
            yield Metric(
                name,
                float(forces[:, columns].max()),
                per,
                bound if np.isfinite(bound) else None,
                meaning=f"largest {'force' if unit == 'm' else 'torque'} of a motor",
            )


def _draw(scenario: MechanismScenario, run: Run, canvas: "Canvas") -> None:
    built = scenario.machine.built
    error, time = frame_error(scenario, run), run.time
    moved = run["truth.pose"][:, list(built.parts)] - built.home
    kinds = [
        (unit, factor, [i for i, part in enumerate(built.parts) if part_unit(part)[0] == unit])
        for unit, factor in (part_unit(0), part_unit(3))
    ]
    kinds = [kind for kind in kinds if kind[2]]
    panels: Any = canvas.subplots(2 * len(kinds) + 1, 1, sharex=True)
    for (unit, factor, columns), above, below in zip(
        kinds, panels[: len(kinds)], panels[len(kinds) : -1], strict=True
    ):
        for i in columns:
            name = PARTS[built.parts[i]]
            above.plot(time, factor * moved[:, i], label=name)
            below.plot(time, factor * error[:, i], label=name)
        above.set_ylabel(f"way [{unit}]")
        below.set_ylabel(f"error [{unit}]")
        above.legend(ncols=3, loc="upper right")
    forces = run["truth.motor_force"]
    units = {"N" if unit == "m" else "N m" for unit in built.motors.units}
    panels[-1].plot(time[1:], forces[1:])
    panels[-1].set_ylabel(f"force [{' or '.join(sorted(units))}]")
    panels[-1].set_xlabel("time [s]")
