"""Let the walking chair carry a passenger a few steps forward and back.

With bodies, contact and closed loops, or quasi-static: Figs. 15 to 18 of the paper. Refused before
the first step where a stroke, a speed, a force or the support would not do.

One cycle forward and back with 57 kg, drives off by up to 2 % and 1 mm/s: body within .50 mm of
the gait's, tilt .007 deg, largest force of a branch 193 N of 427 N, gap of the loops .16 um,
passenger by the currents within .3 kg and 4 mm. Contact must be stiff: with a point stiffness of
1e6 N/m the chair tips where with 1e7 it stands. Here it is 2.5e7.
"""

import copy
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context
from rich.console import Console

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.simulated import Simulation
from parapod.diagrams.style import BOUND, COLOURS
from parapod.diagrams.walking_chair.controller import make_controller
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.diagrams.walking_chair.plants import ChairPlant
from parapod.diagrams.walking_chair.scenario import SIMULATED, ChairScenario
from parapod.sims.lab.experiment import LoopExperiment
from parapod.sims.lab.panel import Panel, Readout, Row
from parapod.sims.lab.run import ReadOut, Run, realtime_metric
from parapod.sims.lab.runner import LOOK_PERIOD, Live, make_viewer
from parapod.sims.output.figures import Figure, draw_bound, shade
from parapod.sims.output.results import Metric
from parapod.systems.core.controls import shown
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.ports import value_of
from parapod.systems.walking_chair.chair import chair_inverse
from parapod.systems.walking_chair.checks import check_forces, check_gait, walk_forces
from parapod.systems.walking_chair.masses import ChairMasses, Passenger
from parapod.systems.walking_chair.operator import ChairControls
from parapod.systems.walking_chair.support import GaitSupport, SupportLost

type Signals = Mapping[str, NDArray[Any]]

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

_NEEDED = (
    "gait_time",
    "done",
    "support",
    "hold",
    "support_margin",
    "payload_estimated",
    "legs.position",
    "legs.velocity",
    "legs.current",
    "truth.body_position",
    "truth.body_attitude",
    "truth.force",
    "truth.foot_height",
    "truth.loop_error",
)
# The bounds of a walk with the paper's largest passenger; those in mm go with the chair's size.
# Feet creep a little, so that each cycle beyond the first adds to the body's error what ten may
# drift.
_BODY_ERROR = 1.0  # [mm]
_TILT = 0.1  # [deg]
_FORCE = 1.24  # largest force of a branch by that at rest [-]
# Mass of that chair with that passenger [kg].
_USUAL = 57.0 + ChairMasses().total
_DRIFT = 5.0  # [mm]
# Contact is stiff, not rigid: under the load of a leg a corner sinks in by a hundredth [mm].
_SINKING = 0.02
# Up to this step of the plant its loops are closed to a micrometre [s].
_FINE_STEP = 1e-3
_LOOP_ERROR = 1.0  # [um]
# The chair has settled on its feet this long after the start [s].
_SETTLED = 0.5
_BRANCHES = ("UP", "UPS 2", "UPS 3")


class ChairExperiment[D](LoopExperiment[ChairScenario, D]):
    """An experiment in which the chair walks."""

    machine = CHAIR
    schema = ChairScenario

    def check(self, scenario: ChairScenario) -> None:
        """Refuses a walk before the first step.

        Raises:
            ScenarioError: names the key.
            StrokeExceeded, SpeedExceeded, ForceExceeded: the gait is more than a branch can do.
            SupportLost: the passenger would come too close to tipping the chair over.
        """
        super().check(scenario)
        walk, passenger = scenario.walk, scenario.passenger.passenger
        machine, drives = scenario.machine, scenario.machine.drives
        for gait in walk.gaits:
            check_gait(machine.geometry, gait, 1e-3 * drives.max_velocity_mm_s)
        required = 1e-3 * scenario.control.support_margin_mm
        GaitSupport(machine.geometry, walk, machine.masses).check(passenger, required)
        limit, stiffness = drives.max_force_N, drives.stiffness
        check_forces(machine.geometry, walk, passenger, machine.masses, limit, stiffness)
        check_stiffness(scenario)

    def duration(self, scenario: ChairScenario) -> float:
        """Standing, walk, standing [s]."""
        return scenario.begin + scenario.walk.duration + scenario.end

    def scene(self, scenario: ChairScenario) -> Meshcat:
        """A scene around the chair's way."""
        ends = [gait.end[1] for gait in scenario.walk.gaits]
        middle = 0.5 * float(np.mean((min(0.0, *ends), max(0.0, *ends))))
        return make_viewer(camera=(2.6, 2.7 + middle, 1.5), target=(0.0, middle, 0.80))


class ChairWalk(ChairExperiment[Run]):
    """Runs the walk."""

    backends = CHAIR.backends
    signals = _NEEDED
    takes = "30 s"
    advice = (
        "The chair walks on, forward and back; move its passenger with the sliders in the "
        "browser. Where the passenger would make it tip over it waits."
    )

    def operated(
        self, scenario: ChairScenario, controls: Any, meshcat: Meshcat | None = None
    ) -> ClosedLoop[ChairScenario]:
        """The walk, step by step while a person holds a button."""
        controller = partial(make_controller, is_operated=True)
        parts: Any = {"controller": controller, "sources": (ChairControls(controls),)}
        return ClosedLoop(CHAIR, scenario, meshcat=meshcat, log=(), **parts)

    def measure(self, scenario: ChairScenario, run: Run) -> Iterator[Metric]:
        """Errors of body and branches, forces, payload and margin.

        Raises:
            SupportLost: the chair stopped because the passenger was too close to tipping it over.
        """
        _refuse_held(scenario, run)
        after_start = run.time >= min(_SETTLED, scenario.begin)
        if "truth.body_position" in run:
            yield from _truth_metrics(scenario, run, after_start)
        yield from _controller_metrics(scenario, run, after_start)
        yield realtime_metric(run)

    def draw(self, scenario: ChairScenario, run: Run) -> Iterator[Figure]:
        """Body, currents (Fig. 17) and margin, as far as the signals allow."""
        if "truth.body_position" in run:
            yield _body(scenario, run.time, run)
        yield _currents(scenario, run.time, run)
        if "truth.body_position" in run:
            yield _margin(scenario, run.time, run)

    def read_out(self, loop: ClosedLoop[Any], root_context: Context) -> Readout:
        """Gait, margin and payload."""

        def read(port: str) -> list[float]:
            return value_of(loop.controller, port, root_context).tolist()

        settings = loop.scenario
        seat, (mass, x, y) = settings.passenger, read("payload_estimated")
        (margin,), (is_held,), (gait_time,) = map(read, ("support_margin", "hold", "gait_time"))
        is_known = mass > 1.0  # [kg]; an empty seat has no centre
        rows = (
            Row("passenger", seat.mass_kg, mass, unit="kg", decimals=1),
            Row("to the right", seat.x_mm, 1e3 * x if is_known else None, unit="mm", decimals=0),
            Row("ahead", seat.y_mm, 1e3 * y if is_known else None, unit="mm", decimals=0),
            Row("margin", settings.control.support_margin_mm, 1e3 * margin, unit="mm", decimals=0),
            Row("walked for", measured=gait_time, unit="s", decimals=1),
        )
        if is_held > 0.5:
            return Readout("waits: the passenger would tip it over", rows, (), True)
        if read("done")[0] > 0.5:
            return Readout("has arrived", rows, idle=(ChairControls.WALK,))
        if any(halt()[0] > 0.5 for halt in loop.readings(root_context, ("halt",)).values()):
            return Readout(f"stands; walks while '{ChairControls.WALK}' is held", rows)
        return Readout("walks", rows)

    def live(
        self, scenario: ChairScenario, panel: Panel, run: Run, console: Console
    ) -> Callable[[], str]:
        """The chair walks on; sliders move its passenger."""
        return LiveChair(scenario, panel, self.read_out).obey


def _refuse_held(scenario: ChairScenario, signals: Signals) -> None:
    """The walk is not over, because the support monitor has held it."""
    holds = signals["hold"][:, 0] > 0.5
    if signals["done"][-1, 0] > 0.5 or not holds[-1]:
        return
    first_held = int(np.argmax(holds))
    walk = scenario.walk
    phase = walk.phase_at(float(signals["gait_time"][first_held, 0]))
    raise SupportLost(
        float(signals["support_margin"][first_held, 0]),
        1e-3 * scenario.control.support_margin_mm,
        walk.phases[min(phase + 1, len(walk.phases) - 1)],
        walk.ends[phase],
    )


def body_desired(scenario: ChairScenario, signals: Signals) -> NDArray[np.float64]:
    """(n, 3) where the body's centre S should have been [m]."""
    times = signals["gait_time"][:, 0]
    motion = scenario.walk.motions(scenario.machine.geometry, times)
    return np.asarray(motion.body.position)


def lengths_desired(scenario: ChairScenario, signals: Signals) -> NDArray[np.float64]:
    """(n, 12) lengths that the branches should have had [m]."""
    times = signals["gait_time"][:, 0]
    motion = scenario.walk.motions(scenario.machine.geometry, times)
    body, feet = motion.body.position, motion.feet.position
    lengths = chair_inverse(scenario.machine.geometry, body, np.eye(3), feet, motion.references)
    return lengths.reshape(len(times), -1)


def _truth_metrics(
    scenario: ChairScenario, signals: Signals, after_start: NDArray[np.bool_]
) -> list[Metric]:
    error = 1e3 * (signals["truth.body_position"] - body_desired(scenario, signals))[after_start]
    attitude = np.degrees(signals["truth.body_attitude"][after_start])
    force = signals["truth.force"][after_start]
    is_fine = scenario.backend == "kinematic" or scenario.plant.time_step <= _FINE_STEP
    drives, passenger = scenario.machine.drives, scenario.passenger.passenger
    weight = scenario.machine.masses, drives.stiffness
    _, at_rest = walk_forces(scenario.machine.geometry, scenario.walk, passenger, *weight)
    return [
        Metric(
            "body_error_mm",
            float(np.linalg.norm(error, axis=1).max()),
            "mm",
            _body_bound(scenario),
            meaning="largest error of the body's centre",
        ),
        Metric(
            "tilt_deg",
            float(np.abs(attitude[:, :2]).max()),
            "deg",
            _TILT,
            meaning="largest roll or pitch of the body",
        ),
        Metric(
            "yaw_deg",
            float(np.abs(attitude[:, 2]).max()),
            "deg",
            meaning="largest heading of the body",
        ),
        Metric(
            "drift_mm",
            float(np.hypot(*error[-1, :2])),
            "mm",
            scenario.machine.geometry.leg.size * _DRIFT,
            meaning="drift of the body along the ground, after all cycles",
        ),
        Metric(
            "foot_below_ground_mm",
            1e3 * max(0.0, -float(signals["truth.foot_height"][after_start].min())),
            "mm",
            _SINKING * weight_share(scenario),
            meaning="largest depth of a foot's corner in the ground, since contact yields",
        ),
        Metric(
            "peak_force_N",
            float(np.abs(force).max()),
            "N",
            min(float(round(_FORCE * np.abs(at_rest).max())), drives.max_force_N),
            paper="427.3 N at most",
            meaning="largest force of any branch",
        ),
        Metric(
            "loop_error_um",
            1e6 * float(signals["truth.loop_error"].max()),
            "um",
            _LOOP_ERROR if is_fine else None,
            meaning="largest gap in the legs' closed loops",
        ),
    ]


def _controller_metrics(
    scenario: ChairScenario, signals: Signals, after_start: NDArray[np.bool_]
) -> list[Metric]:
    late = signals["legs.position"] - lengths_desired(scenario, signals)
    payload = signals["payload_estimated"][after_start][-1]
    passenger = scenario.passenger
    walking = (signals["gait_time"][:, 0] > 0.0) & (signals["done"][:, 0] < 0.5)
    estimates = signals["payload_estimated"][walking]
    mass_error = np.abs(estimates[:, 0] - passenger.mass_kg).max()
    metrics = [
        Metric(
            "branch_error_mm",
            1e3 * float(np.abs(late[after_start]).max()),
            "mm",
            meaning="largest error of a branch's length",
        ),
        Metric(
            "max_branch_speed_mm_s",
            1e3 * float(np.abs(signals["legs.velocity"]).max()),
            "mm/s",
            scenario.machine.drives.max_velocity_mm_s,
            paper=80.0,
            meaning="largest speed of any branch, by the encoders",
        ),
        Metric(
            "support_margin_mm",
            1e3 * float(signals["support_margin"][walking].min()),
            "mm",
            at_least=scenario.control.support_margin_mm,
            meaning="smallest stability margin while walking, from the currents",
        ),
    ]
    if scenario.backend in SIMULATED:
        metrics += [
            Metric(
                "payload_estimated_kg",
                float(payload[0]),
                "kg",
                meaning="payload estimated from the currents",
            ),
            Metric(
                "payload_error_kg",
                float(mass_error),
                "kg",
                meaning="largest error of the payload while walking",
            ),
        ]
        if passenger.mass_kg > 0.0:
            x, y = 1e3 * payload[1:]
            away = math.hypot(x - passenger.x_mm, y - passenger.y_mm)
            metrics.append(
                Metric(
                    "payload_place_error_mm",
                    away,
                    "mm",
                    meaning="error of the payload's centre, at the end",
                )
            )
    return metrics


def _shade_swings(axes: "Axes", time: NDArray[np.float64], signals: Signals) -> None:
    """Shades the times at which two feet are in the air."""
    shade(axes, time, signals["support"].min(axis=1) < 0.5, color="0.93")


def weight_share(scenario: ChairScenario) -> float:
    """Mass of chair and passenger by that of the paper's chair with its largest passenger [-]."""
    return (scenario.passenger.passenger.mass + scenario.machine.masses.total) / _USUAL


def _body_bound(scenario: ChairScenario) -> float:
    """Bound of the body's error, which grows with the cycles [mm]."""
    cycles = max(gait.cycles for gait in scenario.walk.gaits)
    size = scenario.machine.geometry.leg.size
    return size * (_BODY_ERROR + 0.1 * _DRIFT * (cycles - 1))


def _body(scenario: ChairScenario, time: NDArray[np.float64], signals: Signals) -> Figure:
    desired = body_desired(scenario, signals)
    true = signals["truth.body_position"]
    error = 1e3 * (true - desired)
    attitude = np.degrees(signals["truth.body_attitude"])

    def draw(canvas: "Canvas") -> None:
        axes: Any = canvas.subplots(2, 2, sharex=True)
        for row in axes.ravel():
            _shade_swings(row, time, signals)
        for axis, name, colour in ((1, "ahead y", COLOURS[0]), (2, "up z", COLOURS[1])):
            start = desired[0, axis]
            axes[0, 0].plot(time, 1e3 * (desired[:, axis] - start), color=colour, lw=3, alpha=0.3)
            axes[0, 0].plot(time, 1e3 * (true[:, axis] - start), color=colour, label=name)
        axes[0, 0].set_ylabel("body, from its start [mm]")
        axes[0, 0].legend(ncols=2, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        for axis, name in enumerate("xyz"):
            axes[0, 1].plot(time, error[:, axis], label=name)
            label = ("roll", "pitch", "yaw")[axis]
            axes[1, 0].plot(time, attitude[:, axis], label=label)
        axes[0, 1].set_ylabel("error of the body [mm]")
        draw_bound(axes[0, 1], _body_bound(scenario))
        axes[1, 0].set_ylabel("attitude [deg]")
        draw_bound(axes[1, 0], _TILT, "bound of roll and pitch")
        heights = 1e3 * signals["truth.foot_height"].reshape(-1, 4, 3).min(axis=2)
        for leg in range(4):
            axes[1, 1].plot(time, heights[:, leg], label=f"leg {leg + 1}")
        axes[1, 1].set_ylabel("lowest corner [mm]")
        for panel in (axes[0, 1], axes[1, 0], axes[1, 1]):
            panel.legend(ncols=4, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        for panel in axes[1]:
            panel.set_xlabel("time [s]")

    return Figure(
        "chair_walk_body",
        "The walk",
        "Where the body is (pale: where the gait has it), how far it is off, and the feet; "
        "two feet are in the air where the ground is grey. Dashed: bounds.",
        draw,
        (9.0, 5.0),
    )


def _currents(scenario: ChairScenario, time: NDArray[np.float64], signals: Signals) -> Figure:
    currents = signals["legs.current"].reshape(-1, 4, 3)

    def draw(canvas: "Canvas") -> None:
        axes: Any = canvas.subplots(1, 4, sharex=True, sharey=True)
        for leg, panel in enumerate(axes):
            _shade_swings(panel, time, signals)
            for branch, name in enumerate(_BRANCHES):
                panel.plot(time, currents[:, leg, branch], label=name)
            panel.set(title=f"leg {leg + 1}", xlabel="time [s]")
        axes[0].set_ylabel("motor current [A]")
        handles = axes[0].get_legend_handles_labels()
        canvas.legend(*handles, loc="outside upper center", ncols=3)

    return Figure(
        "chair_walk_currents",
        "Currents of the motors",
        "With all branches equally stiff (Fig. 17 for 57 kg; its branches 1 carry more).",
        draw,
        (9.0, 3.2),
    )


def _margin(scenario: ChairScenario, time: NDArray[np.float64], signals: Signals) -> Figure:
    margin = 1e3 * signals["support_margin"][:, 0]
    payload = signals["payload_estimated"]

    def draw(canvas: "Canvas") -> None:
        left, middle, right = canvas.subplots(1, 3, sharex=True)
        for panel in (left, middle, right):
            _shade_swings(panel, time, signals)
            panel.set_xlabel("time [s]")
        left.plot(time, margin, label="this phase and the next")
        required = scenario.control.support_margin_mm
        left.axhline(required, **BOUND, label="required")
        left.set(ylabel="support margin [mm]", ylim=(0.0, None))
        left.legend(ncols=2, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        since_start = time >= scenario.begin
        mass = payload[since_start, 0] - scenario.passenger.mass_kg
        middle.plot(time[since_start], mass)
        middle.set_ylabel("error of the payload's mass [kg]")
        places = (scenario.passenger.x_mm, scenario.passenger.y_mm)
        for axis, (name, place) in enumerate(zip("xy", places, strict=True), start=1):
            away = 1e3 * payload[since_start, axis] - place
            right.plot(time[since_start], away, color=COLOURS[axis], label=name)
        right.set_ylabel("error of its centre of mass [mm]")
        right.legend(ncols=2, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))

    return Figure(
        "chair_walk_margin",
        "Support margin and payload",
        "From the motors' currents alone: how far the centre of mass is inside the support "
        "polygon, and how well the passenger is known.",
        draw,
        (9.0, 3.2),
    )


def check_stiffness(scenario: ChairScenario) -> None:
    """Refuses branches that give way by more than half of what the body's error may be.

    Raises:
        ScenarioError: names the key, and the admissible values.
    """
    machine, passenger = scenario.machine, scenario.passenger.passenger
    drives, masses = machine.drives, machine.masses
    _, at_rest = walk_forces(machine.geometry, scenario.walk, passenger, masses, drives.stiffness)
    way, most = 1e3 * float(np.abs(at_rest).max()) / drives.stiffness, 0.5 * _body_bound(scenario)
    if way > most:
        key, own = "machine.drives.stiffness_N_um", drives.stiffness_N_um
        raise ScenarioError(
            f"{key} = {own:g}: at rest a branch gives way by {way:.2g} mm, and {most:.2g} mm is "
            f"tolerable; it must be at least {math.ceil(1e3 * own * way / most) / 1e3:g}",
            key,
        )


# Name, smallest and largest value, step: of the passenger's mass and place.
_SLIDERS = (
    ("passenger [kg]", 20.0, 120.0, 1.0),
    ("to the right [mm]", -150.0, 150.0, 5.0),
    ("ahead [mm]", -150.0, 150.0, 5.0),
)


class LiveChair(Live):
    """A chair that walks forward and back until another request.

    Args:
        scenario: its gait, plant and control are taken.
        panel: the page with the scene and the sliders.
        read_out: says what the page shows.
    """

    def __init__(self, scenario: ChairScenario, panel: Panel, read_out: ReadOut):
        self._scenario = copy.deepcopy(scenario)
        gait = self._scenario.gait
        gait.way, gait.cycles = "forward and back", max(gait.cycles, 2)
        loop = ClosedLoop(CHAIR, self._scenario, meshcat=panel.meshcat, log=())
        super().__init__(panel, loop, read_out)
        plant = loop.station.behind.handle_as(Simulation).plant
        assert isinstance(plant, ChairPlant)
        self._plant = plant
        self._seated: Passenger | None = None

    def begin(self) -> None:
        """Puts the chair where its walk begins, with the passenger of the sliders."""
        self._seated = None
        super().begin()

    def advance(self, duration: float = LOOK_PERIOD) -> None:
        """Simulates for a duration [s], with the passenger of the sliders."""
        passenger, seat = self.asked(), self._scenario.passenger
        if passenger != self._seated:
            self._plant.seat(self.simulator.get_mutable_context(), passenger)
            self._seated = passenger
            # What the page shows as asked for.
            seat.mass_kg, seat.x_mm, seat.y_mm = (
                self.panel.GetSliderValue(name) for name, *_ in _SLIDERS
            )
        super().advance(duration)
        if self.signal(self.loop.controller, "done")[0] > 0.5:
            self.begin()

    def asked(self) -> Passenger:
        """The passenger that the sliders ask for."""
        mass, x, y = (self.panel.GetSliderValue(name) for name, *_ in _SLIDERS)
        height = 1e-3 * self._scenario.passenger.height_mm
        return Passenger(mass, 1e-3 * x, 1e-3 * y, height)

    def shown(self) -> AbstractContextManager[None]:
        """Shows the passenger's sliders, and takes them away at the end."""
        seat = self._scenario.passenger
        values = (min(max(seat.mass_kg, _SLIDERS[0][1]), _SLIDERS[0][2]), seat.x_mm, seat.y_mm)
        pairs = zip(_SLIDERS, values, strict=True)
        return shown(self.panel, [(*slider, value) for slider, value in pairs])
