"""Experiments in which the platform levels itself: checks, scene, posture errors, live sliders."""

import copy
import math
from collections.abc import Mapping
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Cylinder, Meshcat, Rgba
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import Context
from rich.console import Console

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.controller import make_controller
from parapod.diagrams.levelling_platform.machine import PLATFORM, make_job_sources
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.plots import ROLE_COLOURS
from parapod.diagrams.style import COLOURS
from parapod.sims.lab.experiment import LoopExperiment
from parapod.sims.lab.panel import Panel, Readout, Row
from parapod.sims.lab.run import ReadOut
from parapod.sims.lab.runner import Live, make_viewer, simulate
from parapod.sims.output.figures import Figure, draw_bound
from parapod.sims.output.results import Metric
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.ports import value_of
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import (
    forward_kinematics,
    inverse_kinematics,
    posture_jacobian,
)
from parapod.systems.levelling_platform.sliders import PostureSliders

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas


class LevellingExperiment[D](LoopExperiment[LevellingScenario, D]):
    """An experiment in which the platform levels itself and follows postures."""

    machine = PLATFORM
    schema = LevellingScenario

    def check(self, scenario: LevellingScenario) -> None:
        """Refuses actuators that cannot level, and a job whose times do not fit together."""
        super().check(scenario)
        check_friction(scenario)
        job = scenario.job
        times = [waypoint.time for waypoint in job.waypoints]
        for i, (earlier, later) in enumerate(pairwise(times), start=1):
            if later < earlier:
                _refuse(
                    f"job.waypoints.{i}.time",
                    later,
                    f"earlier than the waypoint before, {earlier:g}",
                )
        if times and times[0] < job.settled_after:
            why = f"earlier than job.settled_after = {job.settled_after:g}"
            _refuse("job.waypoints.0.time", times[0], why)
        swung = job.arm.start + job.arm.duration
        for what, at in (
            ("job.settled_after", job.settled_after),
            ("the last waypoint", max(times, default=0.0)),
            ("the end of the arm's swing", swung),
        ):
            if job.end <= at:
                _refuse("job.end", job.end, f"not after {what}, {at:g}")

    def duration(self, scenario: LevellingScenario) -> float:
        """End of the job [s]."""
        return scenario.job.estimate_at + scenario.job.end

    def scene(self, scenario: LevellingScenario) -> Meshcat:
        """The ground's slope against a horizontal floor."""
        return make_scene(scenario)

    def read_out(self, loop: ClosedLoop[Any], root_context: Context) -> Readout:
        """The posture that is asked for, measured and true."""
        return read_posture(loop, root_context)


# Distance from its goal at which a leg that friction holds stops, by the voltage that lifts the
# platform, the actuator's gain and the time constant of its loop [-]; the inclination that all
# legs together may leave so, half of what "level" tolerates [deg].
_STOPS, _TOLERATED = 0.2, 0.1


def check_friction(scenario: LevellingScenario) -> None:
    """Refuses actuators whose friction holds the platform off level.

    Of 60 platforms at random those that this puts at .1 deg or less were off by .16 deg at most,
    sensors' errors included, and some of those above .15 deg by more than .2 deg.

    Raises:
        ScenarioError: names the key, and the admissible values.
    """
    machine, pole = scenario.machine, scenario.tuned_control.pole
    assert pole is not None
    if machine.actuators.model == "integrator":
        return
    off = _STOPS * machine.friction_voltages[1] * machine.actuators.params.gain / pole
    level = (0.0, 0.0, machine.working_height)
    by_leg = np.abs(np.linalg.pinv(posture_jacobian(machine.geometry, level, (0.0, 0.0))))
    angle = math.degrees(off * float(by_leg[:2].sum(axis=1).max()))
    if angle > _TOLERATED:
        key, own = "machine.actuators.motor_constant_N_V", machine.actuators.motor_constant_N_V
        raise ScenarioError(
            f"{key} = {own:g}: the legs break away from friction only when the platform is "
            f"{angle:.2g} deg off, and {_TOLERATED:g} deg is tolerable; it must be at least "
            f"{math.ceil(own * angle / _TOLERATED)}",
            key,
        )


def _refuse(key: str, value: float, why: str) -> None:
    raise ScenarioError(f"{key} = {value:g} s is {why} s", key)


# Places of camera and of what it looks at, by the machine's size [m].
_CAMERA, _TARGET = (1.5, -5.4, 1.2), (0.25, 0.0, 1.0)
# Both where all places of the arm's tip are in sight.
_OF_ALL = (2.2, -8.0, 1.6), (0.1, 0.0, 1.3)


def make_scene(scenario: LevellingScenario, with_arm: bool = False) -> Meshcat:
    """A scene in which the ground's slope shows against a horizontal floor.

    Args:
        scenario: its machine and ground are shown.
        with_arm: true if all places of the arm's tip are to be in sight.
    """
    size, slab = scenario.machine.size, scenario.machine.structure.ground_size
    places = _OF_ALL if with_arm else (_CAMERA, _TARGET)
    camera, target = ((size * np.array(place)).tolist() for place in places)
    meshcat = make_viewer(camera, target)
    R_WG = RollPitchYaw(*scenario.ground.inclination, 0.0).ToRotationMatrix()
    # Under the slab of `ground.urdf`, which is 2.6 m by 2.2 m and 0.04 m thick.
    rim = slab * np.array([(-1.3, -1.1), (1.3, -1.1), (1.3, 1.1), (-1.3, 1.1)])
    top = R_WG @ np.column_stack([rim, np.full(4, -0.04)]).T
    floor = top[2].min() - 0.05
    vertices = np.hstack([top, np.vstack([top[:2], np.full(4, floor)])])
    sides = [(i, 4 + i, 4 + (i + 1) % 4) for i in range(4)]
    sides += [(i, 4 + (i + 1) % 4, (i + 1) % 4) for i in range(4)]
    meshcat.SetTriangleMesh("/ground", vertices, np.array(sides).T, Rgba(0.50, 0.46, 0.41))
    meshcat.SetObject("/floor", Cylinder(4.5 * slab, 0.02), Rgba(0.86, 0.89, 0.91))
    meshcat.SetTransform("/floor", RigidTransform(np.array([0.0, 0.0, floor - 0.01])))
    return meshcat


# A posture's elements: key of the error, unit, what the axis of a figure says.
AXES = (
    ("roll_error_deg", "deg", "roll [deg]"),
    ("pitch_error_deg", "deg", "pitch [deg]"),
    ("height_error_mm", "mm", "height [mm]"),
)


def in_deg_and_mm(posture: NDArray[np.float64]) -> NDArray[np.float64]:
    """Postures (..., 3) in deg, deg, mm instead of rad, rad, m."""
    return posture * [math.degrees(1.0), math.degrees(1.0), 1e3]


# Signals that `measured_posture` is made of.
MEASURED = (
    "attitude_estimated",
    "ground_estimated",
    "ground_valid",
    "foot_offsets_estimated",
    "legs.extension",
)
AS_MEASURED = (
    "posture as measured: angles by the inertial sensor, heights by the encoders on the "
    "estimated ground"
)


def measured_posture(
    signals: Mapping[str, NDArray[np.float64]], scenario: LevellingScenario
) -> NDArray[np.float64]:
    """Postures (n, 3) as the machine's own sensors measure them [rad, rad, m].

    Roll and pitch are those of the inertial sensor, which knows nothing of the legs; the height is
    that of the extensions on the estimated ground, and NaN before there is one.

    Args:
        signals: extensions, attitude and ground of a run, by the names of their ports.
        scenario: machine as its controller knows it.
    """
    ground, valid = signals["ground_estimated"], signals["ground_valid"][:, 0] > 0.5
    posture = np.full((len(ground), 3), np.nan)
    posture[:, :2] = signals["attitude_estimated"]
    posture[valid] = np.column_stack(
        [
            posture[valid, :2],
            forward_kinematics(
                scenario.geometry_as_known,
                signals["legs.extension"][valid] + scenario.control.encoder_offsets,
                ground[valid],
                legs=(0, 1, 2),
                foot_offsets=signals["foot_offsets_estimated"][valid],
            )[:, 2],
        ]
    )
    return posture


def error_metrics(
    error: NDArray[np.float64],
    prefix: str = "",
    bounds: tuple[float | None, float | None] = (None, None),
    paper: tuple[float | None, float | None, float | None] = (None, None, None),
    condition: str = "",
    undefined: str = "",
) -> list[Metric]:
    """The largest errors as metrics `<prefix>roll_error_deg`, and so on.

    Args:
        error: (n, 3) errors [deg, deg, mm].
        prefix: prefix of the keys.
        bounds: bounds of the angles [deg] and of the height [mm]; None for none.
        paper: values of the paper for roll, pitch [deg] and height [mm].
        condition: time and reference of the errors, for people.
        undefined: reason for which there may be no finite errors.
    """
    largest = np.abs(error).max(axis=0)
    return [
        Metric(
            prefix + key,
            float(largest[i]),
            unit,
            bounds[0] if unit == "deg" else bounds[1],
            paper=paper[i],
            meaning=f"largest {key.split('_')[0]} error {condition}",
            undefined=undefined,
        )
        for i, (key, unit, _) in enumerate(AXES)
    ]


def posture_figure(
    name: str,
    title: str,
    caption: str,
    time: NDArray[np.float64],
    lines: dict[str, NDArray[np.float64]],
    reference: str,
    counts_from: float = -math.inf,
    bounds: tuple[float | None, float | None] = (None, None),
) -> Figure:
    """Roll, pitch and height over time, above their errors against one of the lines.

    The axes of the errors are those of the errors that count; what is larger before leaves them.

    Args:
        name: name of the figure's file.
        title: a few words.
        caption: a sentence or two.
        time: (n) [s].
        lines: label -> (n, 3) posture [deg, deg, mm].
        reference: label of the line that the others are compared with.
        counts_from: time from which on errors count, which is marked [s].
        bounds: bounds of the errors of angles [deg] and of the height [mm]; None for none.
    """
    counts = time >= counts_from
    roles = {line: ROLE_COLOURS[line] for line in lines if line in ROLE_COLOURS}
    in_turn = (colour for colour in COLOURS if colour not in roles.values())
    colours = {line: roles.get(line) or next(in_turn) for line in lines}

    def draw(canvas: "Canvas") -> None:
        axes: Any = canvas.subplots(2, 3, sharex=True, height_ratios=(2, 1))
        for i, (_, unit, label) in enumerate(AXES):
            errors = []
            for line, posture in lines.items():
                width = 2.2 if line == reference else 1.0
                colour = colours[line]
                axes[0, i].plot(time, posture[:, i], color=colour, linewidth=width, label=line)
                if line != reference:
                    errors.append(posture[:, i] - lines[reference][:, i])
                    axes[1, i].plot(time, errors[-1], color=colour, linewidth=1.0)
            axes[1, i].set_ylim(_limits(np.array(errors)[:, counts]))
            draw_bound(axes[1, i], bounds[0] if unit == "deg" else bounds[1])
            axes[0, i].set_ylabel(label)
            axes[1, i].set_ylabel(f"error [{label.split('[')[1]}")
            axes[1, i].set_xlabel("time [s]")
            if not counts.all():
                for row in axes[:, i]:
                    row.axvspan(time[0], counts_from, color="0.93", zorder=0, label=_UNCOUNTED)
        canvas.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=5)

    if bounds != (None, None):
        caption += " Dashed: bounds of the errors."
    return Figure(name, title, caption, draw, (9.0, 4.4))


_UNCOUNTED = "errors do not count yet"


def _limits(errors: NDArray[np.float64]) -> tuple[float, float] | None:
    """Ends of an axis on which all these errors are seen beside zero; None if there are none."""
    finite = errors[np.isfinite(errors)]
    low, high = min(0.0, finite.min(initial=0.0)), max(0.0, finite.max(initial=0.0))
    margin = 0.08 * (high - low)
    return (low - margin, high + margin) if margin > 0.0 else None


class LivePlatform(Live):
    """The scenario's platform, which levels itself and then obeys sliders.

    Args:
        scenario: the job's; its waypoints and the arm's swing are left out.
        panel: the page with the scene and the sliders.
        read_out: says what the page shows.
    """

    def __init__(self, scenario: LevellingScenario, panel: Panel, read_out: ReadOut):
        scenario = copy.deepcopy(scenario)
        scenario.job.arm.angle_deg = 0.0
        self._job = scenario.job
        geometry = scenario.geometry_as_known
        sliders = PostureSliders(panel, scenario.level_height, geometry)
        loop = ClosedLoop(
            PLATFORM,
            scenario,
            meshcat=panel.meshcat,
            controller=partial(make_controller, on_unreachable="clamp"),
            sources=(sliders, *make_job_sources(scenario)),
            log=(),
        )
        super().__init__(panel, loop, read_out)

    @property
    def posture(self) -> NDArray[np.float64]:
        """True roll, pitch, height (3) [rad, rad, m]."""
        return self.signal(self.loop.station, "truth.posture")

    def level(self, console: Console) -> None:
        """Begins anew: estimates the ground and levels, as fast as possible."""
        self.begin()
        until = self._job.estimate_at + self._job.settled_after
        simulate(self.simulator, until, console, "levelling for the sliders")


def read_posture(
    loop: ClosedLoop[Any], root_context: Context, asked_by: str = "posture_command"
) -> Readout:
    """The posture that is asked for, measured and true, in a loop that levels the platform.

    Args:
        loop: loop with a controller that has the posture chain's outputs.
        root_context: root context of the simulator.
        asked_by: the controller's port that asks for the posture.
    """
    controller, station = loop.controller, loop.station
    read = partial(value_of, controller, root_context=root_context)
    desired_values, desired = read(asked_by), read("posture_desired_state")
    standing = read("ground_estimated"), read("foot_offsets_estimated")
    is_known = bool(read("ground_valid")[0] > 0.5)
    control, geometry = loop.scenario.control, loop.scenario.geometry_as_known
    extension = read("legs.extension") + control.encoder_offsets
    legs = forward_kinematics(
        geometry, extension, standing[0], (0, 1, 2), foot_offsets=standing[1]
    )
    measured = np.append(read("attitude_estimated"), legs[2] if is_known else math.nan)
    true = np.full(3, math.nan)
    if station.HasOutputPort("truth.posture"):
        true = value_of(station, "truth.posture", root_context)
        # As is asked for: above the mean of the ground under the feet.
        true[2] -= 1e-3 * np.mean(loop.scenario.ground.foot_heights_mm)
    postures = [in_deg_and_mm(posture) for posture in (desired_values, measured, true)]
    rows = [
        Row(
            label,
            _known(postures[0][i]),
            _known(postures[1][i]),
            _known(postures[2][i]),
            unit,
            decimals,
        )
        for i, (label, unit, decimals) in enumerate(
            (("roll", "deg", 2), ("pitch", "deg", 2), ("height", "mm", 1))
        )
    ]
    ground = np.degrees(standing[0])
    if is_known:
        rows += [
            Row("ground's roll", measured=float(ground[0]), unit="deg"),
            Row("ground's pitch", measured=float(ground[1]), unit="deg"),
        ]
    rows.append(Row("time", measured=root_context.get_time(), unit="s", decimals=1))
    return Readout(_state(geometry, desired_values, measured, desired, standing, is_known), rows)


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _state(
    geometry: PlatformGeometry,
    desired_posture: NDArray[np.float64],
    measured: NDArray[np.float64],
    desired: NDArray[np.float64],
    standing: tuple[NDArray[np.float64], NDArray[np.float64]],
    is_known: bool,
) -> str:
    """State of the platform, in a few words."""
    if not is_known:
        return "waiting for the estimate of the ground"
    reached = inverse_kinematics(geometry, desired_posture, *standing, on_unreachable="nan")
    if not np.isfinite(reached).all():
        return "clamped: the legs do not reach what is asked"
    tilt = math.degrees(math.acos(math.cos(measured[0]) * math.cos(measured[1])))
    if np.abs(desired[3:]).max() > 1e-9:
        return "moving"
    if np.abs(desired[:3] - desired_posture).max() > 1e-9:
        return "waiting to move"
    return f"at rest, {tilt:.2f} deg from level"
