"""Drake and MuJoCo on one motion without Python in the loop: speed against accuracy.

The platform follows a smooth motion of its posture on ground that pitches by 5 deg. Both engines
get the rods' exact extensions one step ahead, as trajectories in C++ or as an array of controls,
and are judged by how far the posture is from the one that these extensions have in closed form.

`python -m benchmarks engines [--out FILE] [--quick]` searches MuJoCo's best settings, measures
all cases in turn, prints a table, and writes a picture.
"""

import argparse
import itertools
import logging
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import SceneGraph
from pydrake.math import RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from rich.console import Console
from rich.table import Table

from benchmarks.merged import Machine, Merger
from parapod.diagrams.levelling_platform.model import DRAWN, add_platform
from parapod.diagrams.style import COLOURS
from parapod.sims.output.atomic import atomic_output
from parapod.sims.output.figures import Figure, Print, render
from parapod.systems.core.extras import need
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.leg import swing_motion
from parapod.systems.levelling_platform.plane import normal_of
from parapod.systems.physics.mujoco.model import MujocoModel

type Floats = NDArray[np.float64]

GROUND = (0.0, math.radians(5.0))
DURATION = 5.0  # duration of the motion [s]
# Accuracy that is asked for: what the paper's own co-simulation is off.
ANGLE, HEIGHT = 0.07, 0.3  # [deg, mm]
# Aim: Drake's speed by MuJoCo's, each the fastest of those that are accurate enough.
AIM = 2.0
_LEGS = ("full", "reduced")
_STEPS = (1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1)
# Longest step that is compared: with longer ones a motion this slow is kinematics [s].
_LONGEST = 2e-2
_ACCURACIES = (1e-1, 1e-2, 1e-3)  # accuracies of Drake's error control
_SETTLED = 0.5  # the platform has come to rest on its feet [s]
_SAMPLES = 40  # postures that are judged
_SPACING = 0.01  # spacing of the references' knots [s]


def posture_at(t: Floats) -> Floats:
    """(n, 3) postures of the motion [rad, rad, m]; it begins at rest."""
    share = np.clip(t, 0.0, 1.0)
    eased = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    roll = math.radians(1.0) * np.sin(2.0 * math.pi * t / 5.0)
    pitch = math.radians(0.8) * np.sin(2.0 * math.pi * t / 4.0)
    height = 6e-3 * np.sin(2.0 * math.pi * t / 3.0)
    posture = eased[:, None] * np.column_stack((roll, pitch, height))
    return posture + np.array((0.0, math.radians(3.0), 0.477))


def references(leg: str) -> tuple[Floats, Floats, Floats]:
    """Times (n), positions (n, 4) and rates (n, 4) of the legs' driven joints."""
    t = np.arange(-1.0, DURATION + 1.0, _SPACING)
    extension = inverse_kinematics(DRAWN, posture_at(t), GROUND)
    rate = np.gradient(extension, _SPACING, axis=0)
    if leg == "full":
        return t, extension, rate
    pairs = zip(DRAWN.legs, extension.T, strict=True)
    legs = [swing_motion(dimensions, d) for dimensions, d in pairs]
    angle = np.column_stack([angle for angle, _ in legs])
    return t, angle, np.column_stack([ratio for _, ratio in legs]) * rate


def spline(t: Floats, position: Floats, rate: Floats) -> PiecewisePolynomial:
    """One joint's positions (n) and rates (n) at times (n), as cubics."""
    cubics: Any = PiecewisePolynomial
    polynomial: PiecewisePolynomial = cubics.CubicHermite(t, position[None], rate[None])
    return polynomial


def errors(t: Floats, poses: Floats) -> tuple[float, float]:
    """Largest error of an angle [deg] and of the height [mm] of the platform's poses (n, 7)."""
    if not np.isfinite(poses).all():
        return math.inf, math.inf
    turns = [Quaternion(q / np.linalg.norm(q)) for q in poses[:, :4]]
    angles: Any = np.array([RollPitchYaw(turn).vector()[:2] for turn in turns])
    heights = poses[:, 4:] @ np.array(normal_of(*GROUND))
    wrong = np.abs(np.column_stack((angles, heights)) - posture_at(t))
    return math.degrees(wrong[:, :2].max()), 1e3 * float(wrong[:, 2].max())


def place(plant: MultibodyPlant, leg: str) -> Machine:
    """Puts the platform into a plant, at the motion's beginning; only feet and ground touch.

    Bodies that do not move against each other are one: that changes neither masses nor motion,
    and spares both engines half of their bodies.

    Args:
        plant: empty, and registered with a scene graph; finalized here.
        leg: leg model.
    """
    whole, scene_graph = MultibodyPlant(1e-3), SceneGraph()
    whole.RegisterAsSourceForSceneGraph(scene_graph)
    model = add_platform(whole, leg, ground=GROUND)
    (start,) = posture_at(np.zeros(1))
    extension = inverse_kinematics(DRAWN, start, GROUND)
    positions = model.positions(extension, start, GROUND, (0.0, 0.0))
    feet = [whole.GetCollisionGeometriesForBody(body) for body in model.leg_bodies("roller")]
    ground = whole.GetCollisionGeometriesForBody(whole.GetBodyByName("ground"))
    return Merger(whole, plant, scene_graph).merge(
        model, [*itertools.chain(*feet), *ground], positions
    )


@dataclass
class Case:
    """One engine with one set of settings.

    Attributes:
        engine: "Drake" or "MuJoCo".
        leg: leg model.
        step: step, or the longest one of error control [s].
        settings: further settings, by name.
        error: errors of angles [deg] and height [mm].
        seconds: times that it took [s].
    """

    engine: str
    leg: str
    step: float
    settings: Mapping[str, Any] = field(default_factory=dict)
    error: tuple[float, float] = (math.inf, math.inf)
    seconds: list[float] = field(default_factory=list)

    @property
    def label(self) -> str:
        more = ", ".join(f"{name} {value}" for name, value in self.settings.items())
        step = f"{1e3 * self.step:g} ms" if "accuracy" not in self.settings else "CENIC"
        return ", ".join(text for text in (self.engine, self.leg, step, more) if text)

    @property
    def factor(self) -> float:
        """Real-time factor of the best run."""
        return DURATION / min(self.seconds)

    @property
    def is_accurate(self) -> bool:
        return self.error[0] <= ANGLE and self.error[1] <= HEIGHT

    @cached_property
    def bench(self) -> "DrakeBench | MujocoBench":
        kind = DrakeBench if self.engine == "Drake" else MujocoBench
        return kind(self.leg, self.step, **self.settings)

    def judge(self) -> None:
        """Takes the errors; a simulation that breaks down has infinite ones."""
        bench = self.bench
        try:
            self.error = bench.errors()
        except RuntimeError:
            self.error = (math.inf, math.inf)

    def clock(self) -> None:
        self.seconds.append(self.bench.seconds())


class DrakeBench:
    """A diagram of the plant and of C++ sources; the context is used again for every run.

    Args:
        leg: leg model.
        step: step; with an accuracy the longest one [s].
        contact: discrete contact approximation.
        accuracy: accuracy of error control; None for steps of one length.
    """

    def __init__(
        self, leg: str, step: float, contact: str = "lagged", accuracy: float | None = None
    ):
        self._step, self._is_discrete = step, accuracy is None
        config = MultibodyPlantConfig(
            time_step=step if self._is_discrete else 0.0,
            contact_model="point",
            discrete_contact_approximation=contact,
            use_sampled_output_ports=False,
        )
        builder = DiagramBuilder()
        self._plant, _ = AddMultibodyPlant(config, builder)
        self._machine = place(self._plant, leg)
        t, position, rate = references(leg)
        # Steps arrive where the reference will be at their end; error control follows it.
        ahead = step if self._is_discrete else 0.0
        for i, instance in enumerate(self._machine.legs):
            reference = spline(t - ahead, position[:, i], rate[:, i])
            source = builder.AddSystem(TrajectorySource(reference, 1))
            sink = self._plant.get_desired_state_input_port(instance)
            builder.Connect(source.get_output_port(), sink)
        self._diagram = builder.Build()
        self._simulator = Simulator(self._diagram)
        if accuracy is not None:
            settings = SimulatorConfig(
                integration_scheme="cenic",
                accuracy=accuracy,
                max_step_size=step,
                use_error_control=True,
            )
            ApplySimulatorConfig(settings, self._simulator)

    def _begin(self) -> Any:
        context = self._simulator.get_mutable_context()
        context.SetTime(0.0)
        self._diagram.SetDefaultContext(context)
        self._simulator.Initialize()
        return self._plant.GetMyContextFromRoot(context)

    def seconds(self) -> float:
        self._begin()
        started = time.perf_counter()
        self._simulator.AdvanceTo(DURATION)
        return time.perf_counter() - started

    def errors(self) -> tuple[float, float]:
        """Errors at the ends of steps, of which the state tells until the next one."""
        context = self._begin()
        ends, poses = sampled(self._step if self._is_discrete else 0.1), []
        for end in ends:
            # In the middle of a step, where no event can come before or after.
            self._simulator.AdvanceTo(end - (0.5 * self._step if self._is_discrete else 0.0))
            poses.append(self._plant.GetPositions(context)[self._machine.pose])
        return errors(ends, np.array(poses))


def sampled(step: float) -> Floats:
    """Ends of steps at which postures are judged [s]."""
    first, last = math.ceil(_SETTLED / step) + 1, round(DURATION / step)
    return step * np.unique(np.linspace(first, last, _SAMPLES).astype(int))


class MujocoBench:
    """The translated plant, rolled out by MuJoCo in C.

    Args:
        leg: leg model.
        step: step [s].
        soft: stiffness of contacts by that of the translation.
        relaxed: time in which contacts relax, by the step.
        stops: rate at which friction stops what slides [1/s].
        ratio: ratio of the regularisations of normal and tangential forces.
        cone: friction cone.
        iterations: iterations of the solver.
        integrator: integrator; all but "discrete" take constraints by MuJoCo's own parameters.
        solver: solver.
    """

    def __init__(
        self,
        leg: str,
        step: float,
        soft: float = 1.0,
        relaxed: float = 0.0,
        stops: float = 100.0,
        ratio: float = 1e4,
        cone: str = "elliptic",
        iterations: int = 50,
        integrator: str = "discrete",
        solver: str = "newton",
    ):
        mujoco: Any = need("mujoco")
        self._mujoco, self._step = mujoco, step
        plant, scene_graph = MultibodyPlant(step), SceneGraph()
        plant.RegisterAsSourceForSceneGraph(scene_graph)
        machine = place(plant, leg)
        translated = MujocoModel(plant, scene_graph, machine.balls, machine.couplings)
        translated.write_state(translated.begin(plant.CreateDefaultContext()))
        self._model = model = translated.model
        self._tune(soft, relaxed, stops)
        model.opt.cone = getattr(mujoco.mjtCone, f"mjCONE_{cone.upper()}")
        model.opt.solver = getattr(mujoco.mjtSolver, f"mjSOL_{solver.upper()}")
        model.opt.impratio, model.opt.iterations = ratio, iterations
        if integrator != "discrete":
            self._as_usual(integrator)
        self._data = mujoco.MjData(model)
        self._data.qpos[:] = translated.data.qpos
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        self._start = np.zeros(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, self._data, self._start, kind)
        self._control = self._controls(leg)
        stepper: Any = need("mujoco.rollout")
        self._step_all = stepper.Rollout(nthread=0)
        floating = next(i for i in range(model.njnt) if model.jnt_type[i] == 0)
        self._pose = 1 + int(model.jnt_qposadr[floating])

    def _tune(self, soft: float, relaxed: float, stops: float) -> None:
        """Changes contacts; a stiffness and its damping are negative in MuJoCo's parameters."""
        model = self._model
        stiffness = soft * model.pair_solref[:, 0]
        model.pair_solref[:, 0] = stiffness
        model.pair_solref[:, 1] = relaxed * self._step * stiffness
        model.pair_solreffriction[:, 1] = -stops * model.pair_solimp[:, 0]

    def _as_usual(self, integrator: str) -> None:
        """Constraints as MuJoCo's users make them stiff: critically damped in two steps."""
        model, mujoco = self._model, self._mujoco
        kind = f"mjINT_{integrator.upper()}"
        model.opt.integrator = getattr(mujoco.mjtIntegrator, kind)
        model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_DIAGEXACT)
        for references in (model.pair_solref, model.eq_solref):
            references[:] = (2.0 * self._step, 1.0)
        model.pair_solreffriction[:] = 0.0
        for impedances in (model.pair_solimp, model.eq_solimp):
            impedances[:, :2] = (0.99, 0.999)
        # Stiff drives are not solved together with constraints; these are as stiff as go.
        model.actuator_biasprm[:, 1:3] /= 1e3
        model.opt.tolerance = 1e-8

    def _controls(self, leg: str) -> Floats:
        t, position, rate = references(leg)
        steps = round(DURATION / self._step)
        ahead: Any = self._step * np.arange(1, steps + 1)
        stiffness, damping = -self._model.actuator_biasprm[:, 1:3].T
        control = np.zeros((steps, self._model.nu))
        for i in range(LEG_COUNT):
            reference = spline(t, position[:, i], rate[:, i])
            control[:, i] = stiffness[i] * reference.vector_values(ahead)[0]
            rates = reference.MakeDerivative().vector_values(ahead)[0]
            control[:, i] += damping[i] * rates
        return control

    def _roll(self) -> Floats:
        """States (n, m) after each step."""
        self._mujoco.mj_resetData(self._model, self._data)
        start, control = self._start[None], self._control[None]
        states, _ = self._step_all.rollout(self._model, self._data, start, control)
        state: Floats = states[0]
        return state

    def seconds(self) -> float:
        started = time.perf_counter()
        self._roll()
        return time.perf_counter() - started

    def errors(self) -> tuple[float, float]:
        states, ends = self._roll(), sampled(self._step)
        pose = states[np.round(ends / self._step).astype(int) - 1, self._pose : self._pose + 7]
        return errors(ends, np.column_stack((pose[:, 3:], pose[:, :3])))


def drake_cases(is_quick: bool) -> Iterator[Case]:
    """Drake's cases: steps, legs, contact approximations, error control."""
    for leg in _LEGS:
        for step in _STEPS[2:6] if is_quick else _STEPS:
            for contact in ("lagged",) if is_quick else ("lagged", "similar", "sap"):
                yield Case("Drake", leg, step, {"contact": contact})
        for accuracy in _ACCURACIES[:1] if is_quick else _ACCURACIES:
            yield Case("Drake", leg, 0.1, {"accuracy": accuracy})


def mujoco_candidates(is_quick: bool) -> Iterator[Case]:
    """Settings of MuJoCo that are searched."""
    grid: dict[str, Sequence[Any]] = {
        "soft": (1.0, 1e-1, 1e-2),
        "relaxed": (0.0, 1.0),
        "stops": (1e2, 1e9),
        "ratio": (1.0, 1e2, 1e4),
        "cone": ("elliptic", "pyramidal"),
    }
    if is_quick:
        grid = {"soft": (1.0, 1e-1), "ratio": (1e2, 1e4)}
    for leg in _LEGS:
        for step in _STEPS[1:6:2] if is_quick else _STEPS:
            for values in itertools.product(*grid.values()):
                yield Case("MuJoCo", leg, step, dict(zip(grid, values, strict=True)))
            for integrator in ("implicitfast", "euler"):
                if step <= 5e-3:
                    yield Case("MuJoCo", leg, step, {"integrator": integrator, "ratio": 10.0})


def refined(best: Sequence[Case]) -> Iterator[Case]:
    """The best settings with fewer iterations, and with other solvers."""
    for case in best:
        for more in ({"iterations": 1}, {"iterations": 3}, {"solver": "cg"}, {"solver": "pgs"}):
            if "integrator" not in case.settings:
                yield Case("MuJoCo", case.leg, case.step, {**case.settings, **more})


def search(candidates: Sequence[Case]) -> list[Case]:
    """The two fastest accurate cases of each leg and step, else the most accurate one."""
    groups: dict[tuple[str, float], list[Case]] = {}
    for case in candidates:
        case.judge()
        if math.isfinite(case.error[0]):
            case.clock()
            case.clock()
            groups.setdefault((case.leg, case.step), []).append(case)
        case.__dict__.pop("bench")  # hundreds of models at once are too many
    candidate_times = []
    for cases in groups.values():
        accurate = [case for case in cases if case.is_accurate]
        if accurate:
            candidate_times += sorted(accurate, key=lambda case: -case.factor)[:2]
        else:
            candidate_times.append(
                min(cases, key=lambda c: max(c.error[0] / ANGLE, c.error[1] / HEIGHT))
            )
    return candidate_times


def measure(cases: Sequence[Case], rounds: int) -> None:
    """Clocks the cases in turn, so that what else the machine does concerns all of them."""
    for case in cases:
        case.seconds.clear()
    for _ in range(rounds):
        for case in cases:
            case.clock()


def table_of(cases: Sequence[Case]) -> Table:
    """All cases, the fastest first."""
    table = Table(title="engines", title_justify="left", title_style="bold")
    for heading in ("settings", "x real time", "us a step", "angle [deg]", "height [mm]", ""):
        table.add_column(heading, justify="left" if heading == "settings" else "right")
    for case in sorted(cases, key=lambda case: -case.factor):
        step = "-" if "accuracy" in case.settings else f"{1e6 * case.step / case.factor:.1f}"
        angle, height = (f"{error:.4f}" for error in case.error)
        mark = "accurate" if case.is_accurate else ""
        table.add_row(case.label, f"{case.factor:.1f}", step, angle, height, mark)
    return table


def picture(cases: Sequence[Case]) -> Figure:
    """Speed against the larger of both errors by its bound."""

    def draw(canvas: Any) -> None:
        axis = canvas.subplots()
        kinds = [(engine, leg) for engine in ("Drake", "MuJoCo") for leg in _LEGS]
        for (engine, leg), colour in zip(kinds, COLOURS, strict=False):
            own = [case for case in cases if (case.engine, case.leg) == (engine, leg)]
            error = [max(case.error[0] / ANGLE, case.error[1] / HEIGHT) for case in own]
            factor = [case.factor for case in own]
            axis.loglog(error, factor, "os"[engine == "MuJoCo"], color=colour, markersize=4)
            axis.lines[-1].set_label(f"{engine}, {leg} legs")
        axis.axvline(1.0, color="0.5", linestyle="--", linewidth=0.8)
        axis.set_xlabel(f"larger error, by {ANGLE:g} deg or {HEIGHT:g} mm [-]")
        axis.set_ylabel("real-time factor [-]")
        axis.legend()

    caption = (
        "A motion of the posture on a slope of 5 deg, without Python in the loop. Left of the "
        "line both errors are within their bounds."
    )
    return Figure("engines", "Speed against accuracy", caption, draw, (7.0, 4.2))


def compare_fastest(cases: Sequence[Case], longest: float, console: Console) -> None:
    """Prints the fastest accurate case of each engine, with steps up to the longest [s]."""
    console.print(f"accurate to {ANGLE:g} deg, {HEIGHT:g} mm; steps to {1e3 * longest:g} ms:")
    fastest = []
    for engine in ("Drake", "MuJoCo"):
        # Error control chooses its steps by itself.
        admitted = [case for case in cases if "accuracy" in case.settings or case.step <= longest]
        own = [case for case in admitted if case.engine == engine and case.is_accurate]
        fastest.append(max(own, key=lambda case: case.factor))
        console.print(f"  {fastest[-1].factor:.0f} x: {fastest[-1].label}", highlight=False)
    ratio = fastest[0].factor / fastest[1].factor
    console.print(f"  Drake by MuJoCo {ratio:.2f}, aim {AIM:g}", highlight=False)


def main(arguments: Sequence[str]) -> int:
    """Searches, measures, prints and draws."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks engines")
    parser.add_argument("--out", type=Path, default=Path("out/engines.svg"), metavar="FILE")
    parser.add_argument("--quick", action="store_true", help="few settings, for a first look")
    parser.add_argument("--rounds", type=int, default=7, help="runs of each case, the best counts")
    options = parser.parse_args(arguments)
    console = Console(width=max(110, Console().width))
    # Many of the settings are unstable, as is to be found out.
    logging.getLogger("parapod.systems.physics").setLevel(logging.ERROR)
    candidates = list(mujoco_candidates(options.quick))
    console.print(f"searching {len(candidates)} settings of MuJoCo ...", highlight=False)
    best = search(candidates)
    if not options.quick:
        best = search([*best, *refined(best)])
    cases = list(drake_cases(options.quick))
    for case in cases:
        case.judge()
    cases = [case for case in cases if math.isfinite(case.error[0])] + best
    measure(cases, options.rounds)
    console.print(table_of(cases))
    for longest in (_LONGEST, max(_STEPS)):
        compare_fastest(cases, longest, console)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with atomic_output(options.out) as temporary:
        temporary.write_bytes(
            render(picture(cases), Print(options.out.suffix[1:], has_caption=True))
        )
    console.print(f"wrote {options.out}", highlight=False)
    return 0
