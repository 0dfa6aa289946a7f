"""Public problems with closed loops on Drake and MuJoCo: error against steps and speed.

Both engines get one declaration of each problem (`benchmarks.references`), and step without
Python. Drake takes steps of one length, with its solver SAP, or is error controlled (CENIC).
MuJoCo takes its integrator `discrete` with the loops' stiffness as parapod sets it, its defaults,
or constraints as stiff as they go, with its integrators of order one and four.
"""

import logging
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import default_model_instance
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from benchmarks.linkage import Motion, Point
from benchmarks.references import (
    ANDREWS,
    BRICARD,
    CRANK,
    FOUR_BAR,
    PROBLEMS,
    Problem,
    coupler_angle,
)
from benchmarks.report import Measurement
from benchmarks.yardstick import DRAKE, seconds
from parapod.diagrams.style import COLOURS
from parapod.sims.output.atomic import atomic_output
from parapod.sims.output.figures import Figure, Print, render
from parapod.systems.core.extras import need
from parapod.systems.physics.mujoco.model import StateMaps
from parapod.systems.physics.mujoco.translation import WEIGHT, Translation, body_name

# Accuracies of Drake's error control [-].
_ACCURACIES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
# Impedance of a constraint in MuJoCo that is as near to rigid as MuJoCo admits [-].
_STIFFEST = 0.9999
# Number of times that each case is clocked, of which the best counts, and the time after which it
# is not repeated [s].
_ROUNDS, _ENOUGH = 5, 1.0
_LOG = logging.getLogger(__name__)


class Runner(Protocol):
    """One engine with one problem and one setting."""

    def motion(self) -> Motion:
        """Motion at the problem's samples."""

    def steps(self) -> int:
        """Number of steps of the last motion."""

    def run(self) -> None:
        """Simulates from the beginning to the end without a stop."""


class DrakeRunner:
    """Drake.

    Args:
        problem: the problem.
        step: step [s]; zero for error control.
        accuracy: accuracy of error control.
    """

    def __init__(self, problem: Problem, step: float = 0.0, accuracy: float = 0.0):
        self._problem, self._step = problem, step
        self._plant = MultibodyPlant(step)
        if step:
            self._plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        problem.linkage.place(self._plant)
        self._simulator = Simulator(self._plant)
        if not step:
            config = SimulatorConfig(
                integration_scheme="cenic",
                accuracy=accuracy,
                max_step_size=problem.end / problem.samples,
                use_error_control=True,
            )
            ApplySimulatorConfig(config, self._simulator)

    def _begin(self) -> Context:
        plant, (q, v) = self._plant, self._problem.exact.start
        context = self._simulator.get_mutable_context()
        context.SetTime(0.0)
        plant.SetDefaultContext(context)
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        if plant.num_actuators():
            plant.get_actuation_input_port().FixValue(context, self._problem.linkage.torques)
            springs = plant.get_desired_state_input_port(default_model_instance())
            springs.FixValue(context, np.zeros(springs.size()))
        self._simulator.Initialize()
        self._simulator.ResetStatistics()
        return context

    def motion(self) -> Motion:
        context, states = self._begin(), []
        for t in self._problem.times:
            # In the middle of a step, where no event can come before or after.
            self._simulator.AdvanceTo(t - 0.5 * self._step)
            states.append(self._plant.GetPositionsAndVelocities(context))
        q, v = np.split(np.array(states), 2, axis=1)
        return Motion(self._problem.times, q, v)

    def steps(self) -> int:
        if self._step:
            return round(self._problem.end / self._step)
        return int(self._simulator.get_integrator().get_num_steps_taken())

    def run(self) -> None:
        self._begin()
        self._simulator.AdvanceTo(self._problem.end - 0.5 * self._step)


class MujocoRunner:
    """MuJoCo, with the plant translated.

    Args:
        problem: the problem.
        step: step [s].
        tune: changes the specification; None: integrator and stiffness are those of parapod.
    """

    def __init__(
        self, problem: Problem, step: float, tune: Callable[[Any, Any, float], None] | None = None
    ):
        self._problem, self._step = problem, step
        self._mujoco: Any = need("mujoco")
        self._mujoco.set_mju_user_warning(_LOG.debug)
        plant = MultibodyPlant(step)
        balls = problem.linkage.place(plant)
        translation = Translation(self._mujoco, plant, plant.CreateDefaultContext())
        translation.add_bodies()
        translation.add_drives()
        translation.add_balls(balls)
        self._add_spring(translation.spec, plant)
        if tune:
            tune(self._mujoco, translation.spec, step)
        self._model: Any = translation.spec.compile()
        if not tune:
            # With it, the impedances of the translation are the stiffness that they are for.
            self._model.body_invweight0[:] = WEIGHT
            self._model.dof_invweight0[:] = WEIGHT
        self._data: Any = self._mujoco.MjData(self._model)
        self._maps = StateMaps(self._model, plant)

    def _add_spring(self, spec: Any, plant: MultibodyPlant) -> None:
        spring = self._problem.linkage.spring
        if spring is None:
            return
        tendon = spec.add_tendon(
            name="spring", stiffness=spring.stiffness, springlength=[spring.length] * 2
        )
        for name, point in (("one", spring.one), ("other", spring.other)):
            self._site(spec, plant, point, f"spring {name}")
            tendon.wrap_site(f"spring {name}")

    @staticmethod
    def _site(spec: Any, plant: MultibodyPlant, point: Point, name: str) -> None:
        body = plant.GetBodyByName(point.link) if point.link else plant.world_body()
        spec.body(body_name(body)).add_site(name=name, pos=point.place)

    def _begin(self) -> None:
        self._mujoco.mj_resetData(self._model, self._data)
        q, v = self._maps.to_mujoco(*self._problem.exact.start)
        self._data.qpos[:], self._data.qvel[:] = q, v
        self._data.ctrl[:] = self._problem.linkage.torques

    def motion(self) -> Motion:
        self._begin()
        states, done_steps = [], 0
        for t in self._problem.times:
            steps = round(t / self._step)
            self._mujoco.mj_step(self._model, self._data, steps - done_steps)
            states.append(self._maps.to_plant(self._data.qpos, self._data.qvel))
            done_steps = steps
        q, v = np.split(np.array(states), 2, axis=1)
        return Motion(self._problem.times, q, v)

    def steps(self) -> int:
        return round(self._problem.end / self._step)

    def run(self) -> None:
        self._begin()
        self._mujoco.mj_step(self._model, self._data, self.steps())


def by_default(mujoco: Any, spec: Any, _: float) -> None:
    """Gives a specification MuJoCo's defaults, but has it go on where it would begin again."""
    usual = mujoco.MjSpec()
    for name in ("integrator", "solver", "cone", "jacobian", "impratio", "tolerance"):
        setattr(spec.option, name, getattr(usual.option, name))
    spec.option.iterations = usual.option.iterations
    equality = usual.add_equality()
    for each in spec.equalities:
        each.solref, each.solimp = equality.solref, equality.solimp


def by_users(mujoco: Any, spec: Any, step: float) -> None:
    """Gives a specification MuJoCo's defaults, but constraints as stiff as users can make them."""
    by_default(mujoco, spec, step)
    for each in spec.equalities:
        each.solref = (2.0 * step, 1.0)
        each.solimp[:2] = _STIFFEST


def fourth_order(mujoco: Any, spec: Any, step: float) -> None:
    """Gives a specification the integrator of order four as well."""
    by_users(mujoco, spec, step)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4


@dataclass(frozen=True)
class Engine:
    """An engine with all settings but the one that makes it more or less accurate.

    Attributes:
        name: engine and settings.
        is_controlled: true if an accuracy is set, and not a step.
        make: makes a runner of a problem, by the step or the accuracy.
    """

    name: str
    is_controlled: bool
    make: Callable[[Problem, float], Runner]

    def settings(self, problem: Problem) -> tuple[float, ...]:
        """Accuracies, or steps [s]."""
        return _ACCURACIES if self.is_controlled else problem.steps


SAP = Engine("Drake, discrete (SAP)", False, DrakeRunner)
CENIC = Engine("Drake, CENIC", True, lambda problem, a: DrakeRunner(problem, accuracy=a))
DISCRETE = Engine("MuJoCo, discrete, loops 1e10 N/m", False, MujocoRunner)
DEFAULTS = Engine(
    "MuJoCo, defaults (Euler, solref .02 s)",
    False,
    lambda problem, step: MujocoRunner(problem, step, by_default),
)
STIFF = Engine(
    "MuJoCo, Euler, solref 2 steps, solimp .9999",
    False,
    lambda problem, step: MujocoRunner(problem, step, by_users),
)
ORDER_FOUR = Engine(
    "MuJoCo, RK4, solref 2 steps, solimp .9999",
    False,
    lambda problem, step: MujocoRunner(problem, step, fourth_order),
)
ENGINES = (SAP, CENIC, DISCRETE, DEFAULTS, STIFF, ORDER_FOUR)
# Bounds of errors, by problem, engine, and step or accuracy [rad, m].
_BOUNDS = (
    (ANDREWS, SAP, 1e-5, 5e-4),
    (ANDREWS, ORDER_FOUR, 1e-5, 5e-6),
    (BRICARD, SAP, 1e-3, 0.015),
    (BRICARD, CENIC, 1e-6, 0.01),
    (BRICARD, DISCRETE, 1e-3, 0.015),
    (BRICARD, ORDER_FOUR, 1e-3, 1e-6),
    (FOUR_BAR, SAP, 1e-3, 1e-3),
    (FOUR_BAR, DISCRETE, 1e-3, 1e-4),
    (CRANK, SAP, 5e-5, 5e-5),
    (CRANK, DISCRETE, 5e-5, 5e-5),
)


@dataclass(frozen=True)
class Case:
    """One engine with one setting on one problem, measured.

    Attributes:
        problem: the problem.
        engine: the engine.
        setting: step [s] or accuracy.
        rate: steps in a second that is simulated [1/s].
        factor: real-time factor, by the time of the processor.
        error: largest error, in the problem's unit; infinite where the motion breaks down.
        energy: largest error of the energy [J].
        drift: change of the energy in all of the time, by the line that fits it best [J].
        gap: largest gap of a loop at the samples [m].
        coupler: largest angle of the four-bar's coupler [rad].
    """

    problem: Problem
    engine: Engine
    setting: float
    rate: float
    factor: float
    error: float
    energy: float = math.nan
    drift: float = math.nan
    gap: float = math.nan
    coupler: float = math.nan

    @property
    def label(self) -> str:
        """The setting, as people write it."""
        return f"{self.setting:g}" if self.engine.is_controlled else f"{1e3 * self.setting:g} ms"


def measure(problem: Problem, engine: Engine, setting: float) -> Case:
    """Measures the errors and the speed of an engine."""
    runner = engine.make(problem, setting)
    motion = runner.motion()
    rate = runner.steps() / problem.end
    durations: list[float] = []
    while len(durations) < _ROUNDS and sum(durations) < _ENOUGH:
        durations.append(seconds(runner.run))
    speed = (rate, problem.end / min(durations))
    error = problem.error(motion)
    if not math.isfinite(error):
        return Case(problem, engine, setting, *speed, error)
    energy = drift = coupler = math.nan
    if problem.is_conservative:
        energies = problem.energies(motion)
        energy = float(np.abs(energies).max())
        drift = float(np.polyfit(motion.t, energies, 1)[0]) * problem.end
    if problem is FOUR_BAR:
        coupler = coupler_angle(motion)
    gap = max(problem.exact.gap(q) for q in motion.q)
    return Case(problem, engine, setting, *speed, error, energy, drift, gap, coupler)


def cases(console: Console) -> Iterator[Case]:
    """All cases; one that an engine refuses or gives up is left out with its reason."""
    for problem in PROBLEMS:
        console.print(f"  {problem.name}, {problem.end:g} s ...", highlight=False)
        for engine in ENGINES:
            for setting in engine.settings(problem):
                try:
                    yield measure(problem, engine, setting)
                except RuntimeError as error:
                    console.print(f"    {engine.name}, {setting:g}: {error}", highlight=False)


def table_of(measured: Sequence[Case]) -> Table:
    """Cases of one problem."""
    problem = measured[0].problem
    name, unit = problem.quantity
    title = f"{problem.name}, {problem.end:g} s: {name}"
    table = Table(title=title, title_justify="left", title_style="bold")
    headings = ("engine", "setting", "steps/s", "x real time", f"error [{unit}]")
    for heading in (*headings, "energy [J]", "drift [J]", "gap [um]"):
        table.add_column(escape(heading), justify="left" if heading == "engine" else "right")
    for case in measured:
        if not math.isfinite(case.error):
            broken = ("breaks down", *3 * ("",))
            table.add_row(case.engine.name, case.label, f"{case.rate:.0f}", "", *broken)
            continue
        figures = (case.energy, case.drift, 1e6 * case.gap)
        table.add_row(
            case.engine.name,
            case.label,
            f"{case.rate:.0f}",
            f"{case.factor:.3g}",
            f"{case.error:.2g}",
            *("" if math.isnan(figure) else f"{figure:.2g}" for figure in figures),
        )
    return table


def table_of_fastest(measured: Sequence[Case]) -> Table:
    """Fastest settings of each engine that are as accurate as wanted, with real-time factors."""
    table = Table(title="fastest settings", title_justify="left", title_style="bold")
    table.add_column("engine")
    for problem in PROBLEMS:
        name, unit = problem.quantity
        heading = f"{problem.name}: {name} up to {problem.wanted:g} {unit}"
        table.add_column(heading, justify="right")
    for engine in ENGINES:
        row = []
        for problem in PROBLEMS:
            own = [c for c in measured if c.problem is problem and c.engine is engine]
            accurate = [case for case in own if case.error <= problem.wanted]
            best = max(accurate, key=lambda case: case.factor, default=None)
            row.append(f"{best.label}: {best.factor:.2g} x" if best else "none")
        table.add_row(engine.name, *row)
    return table


def picture(measured: Sequence[Case]) -> Figure:
    """Error against steps a second and against speed, a column for each problem."""

    def draw(canvas: Any) -> None:
        grid = canvas.subplots(2, len(PROBLEMS))
        for column, problem in zip(grid.T, PROBLEMS, strict=True):
            for engine, colour, marker in zip(ENGINES, COLOURS, "osD^Pv", strict=False):
                own = [c for c in measured if c.problem is problem and c.engine is engine]
                error = [case.error for case in own]
                for axis, along in zip(column, ("rate", "factor"), strict=True):
                    x = [getattr(case, along) for case in own]
                    look = {"color": colour, "marker": marker, "markersize": 3.5}
                    axis.loglog(x, error, label=engine.name, **look)
            column[0].set_title(problem.name, fontsize="medium")
            column[0].set_xlabel("steps a second [1/s]", fontsize="small")
            column[1].set_xlabel("real-time factor [-]", fontsize="small")
            for axis in column:
                name, unit = problem.quantity
                axis.set_ylabel(f"{name} [{unit}]", fontsize="small")
        handles, labels = grid[0, 0].get_legend_handles_labels()
        canvas.legend(handles, labels, loc="outside upper center", ncols=3, fontsize="small")

    caption = f"Largest errors of public problems with closed loops. {versions()}."
    return Figure("closed_loops", "Error against steps and speed", caption, draw, (11.0, 5.6))


def versions() -> str:
    """Versions of both engines."""
    return f"Drake {version('drake')}, MuJoCo {version('mujoco')}"


def bounds(measured: Sequence[Case]) -> list[Measurement]:
    """Errors that are held to a bound, each that of a setting that the page of accuracy names."""
    by_setting = {(c.problem.name, c.engine.name, c.setting): c for c in measured}
    exact = ANDREWS.error(ANDREWS.exact_motion)
    results = [
        Measurement("exact motion, Andrews' angles as published", exact, "rad", 1e-8, at_most=True)
    ]
    for problem, engine, setting, bound in _BOUNDS:
        case = by_setting.get((problem.name, engine.name, setting))
        error, label = (math.inf, f"{setting:g}") if case is None else (case.error, case.label)
        name, unit = f"{problem.name}, {engine.name}, {label}", problem.quantity[1]
        results.append(Measurement(name, error, unit, bound, at_most=True))
    leaving = max(c.coupler for c in measured if math.isfinite(c.coupler))
    results.append(
        Measurement("four-bar's coupler, all engines", leaving, "rad", 0.1, at_most=True)
    )
    return results


def run(console: Console, out: Path | None = None) -> list[Measurement]:
    """Measures, prints, draws, and returns what has a bound.

    Args:
        console: console to print on.
        out: file of the picture, or None.
    """
    console.print(f"  closed loops, {versions()}", highlight=False)
    measured, pace = DRAKE.beside(lambda: list(cases(console)))
    for problem in PROBLEMS:
        console.print(table_of([case for case in measured if case.problem is problem]))
    console.print(table_of_fastest(measured))
    console.print(f"  yardstick {pace.yardstick} x {pace.slowness:.2f}", highlight=False)
    if out:
        out.parent.mkdir(parents=True, exist_ok=True)
        with atomic_output(out) as temporary:
            temporary.write_bytes(
                render(picture(measured), Print(out.suffix[1:], has_caption=True))
            )
        console.print(f"  wrote {out}", highlight=False)
    return bounds(measured)
