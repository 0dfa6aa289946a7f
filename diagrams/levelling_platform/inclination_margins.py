"""Stability of the outer inclination loop: its open loop, linearised, and its margins.

It is differentiated with AutoDiffXd as it is wired. With K off by 15 % and 20 ms of delay beside
the sampling the gain margin is 35.8 dB and the phase margin 89.5 deg. The loop compares the
attitude with the reference as it was when the attitude was measured. A machine that is better than
the sensor's bias (.25 mg, .014 deg an axis) gains nothing: 6 of 20 seeds are up to .016 deg worse
while moving. A dead band of .03 deg leaves 4 of 20 up to .005 deg worse, and breaks the bound of
.05 deg at rest.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from parapod.diagrams.levelling_platform.controller import posture_loop_params
from parapod.diagrams.levelling_platform.position_loops import pi_params
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.linear import linearised
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.linear_actuator import LinearActuator
from parapod.systems.actuators.pi_controller import PiController
from parapod.systems.levelling_platform.feedforward import KinematicFeedforward, PassiveLegSolver
from parapod.systems.levelling_platform.inclination_loop import ForwardKinematics, PostureLoop
from parapod.systems.levelling_platform.kinematics import inverse_kinematics

# Time that the inner loops are given to settle before the diagram is linearised [s].
_SETTLING = 3.0


@dataclass(frozen=True)
class Margins:
    """Stability margins of one axis.

    Attributes:
        gain: factor by which the loop's gain may grow [-].
        phase: loss of phase at the crossover that is still stable [rad].
        crossover: frequency at which the loop's gain is 1 [rad/s].
    """

    gain: float
    phase: float
    crossover: float

    @property
    def gain_db(self) -> float:
        """The gain margin in decibel."""
        return 20.0 * math.log10(self.gain)

    @property
    def delay(self) -> float:
        """Further delay that the loop bears [s]."""
        return self.phase / self.crossover


@dataclass(frozen=True)
class OpenLoop:
    """x' = A x + B u, y = C x: from measured roll and pitch to what the legs make of them.

    Attributes:
        a: (n, n).
        b: (n, 2).
        c: (2, n).
        period: period of the discrete-time system [s].
    """

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    c: NDArray[np.float64]
    period: float

    def response(self, frequency: ArrayLike, delay: float = 0.0) -> NDArray[np.complex128]:
        """Loop gain L(jw) of roll and pitch (m, 2, 2), negative feedback taken out.

        Args:
            frequency: (m) [rad/s], below the Nyquist frequency pi / period.
            delay: delay of the measurement, added to that of the sampling [s].
        """
        w = np.asarray(frequency, dtype=float)[:, np.newaxis, np.newaxis]
        states = np.exp(1j * w * self.period) * np.eye(len(self.a)) - self.a
        return -np.exp(-1j * w * delay) * (self.c @ np.linalg.solve(states, self.b + 0j))


def open_loop(scenario: LevellingScenario, gain_scale: float = 1.0) -> OpenLoop:
    """Linearises `inclination_loop`: feedforward, passive leg, actuators and kinematics.

    The loop is opened where the attitude enters `PostureLoop`. The actuators are the K/s of Eq.
    (17); the attitude filter passes what the gyro measures and counts as 1.

    Args:
        scenario: its ground, height and control part are used.
        gain_scale: the actuators' K over what the controller takes it for [-].
    """
    diagram, context = _settled(scenario, gain_scale)
    model = linearised(diagram, context, ["attitude"], ["posture"])
    return OpenLoop(model.A(), model.B(), model.C()[:2], model.time_period())


def margins(loop: OpenLoop, delay: float = 0.0) -> tuple[Margins, Margins]:
    """Margins of the roll and of the pitch loop, each with the other one closed.

    Args:
        loop: the open loop.
        delay: delay of the measurement [s].
    """
    nyquist = math.pi / loop.period
    frequency = np.geomspace(1e-3, 0.999 * nyquist, 4000)
    response = loop.response(frequency, delay)
    return tuple(_margins(frequency, alone(response, axis)) for axis in range(2))  # type: ignore[return-value]


def alone(response: NDArray[np.complex128], axis: int) -> NDArray[np.complex128]:
    """Loop gain (m) of one axis while the loop of the other one is closed."""
    i, j = axis, 1 - axis
    coupling = response[:, i, j] * response[:, j, i] / (1.0 + response[:, j, j])
    return response[:, i, i] - coupling


def _margins(frequency: NDArray[np.float64], gain: NDArray[np.complex128]) -> Margins:
    magnitude, phase = np.abs(gain), np.unwrap(np.angle(gain))
    phase -= 2.0 * math.pi * round((phase[0] + 0.5 * math.pi) / (2.0 * math.pi))
    falls = magnitude <= 1.0
    crossover = _crossing(frequency, np.log(magnitude), 0.0) if falls.any() else math.nan
    at_crossover = float(np.interp(crossover, frequency, phase))
    margin_phase = _crossing(frequency, phase, -math.pi) if (phase <= -math.pi).any() else math.nan
    at_turn = float(np.interp(margin_phase, frequency, magnitude))
    return Margins(
        gain=1.0 / at_turn if math.isfinite(margin_phase) else math.inf,
        phase=math.pi + at_crossover,
        crossover=crossover,
    )


def _crossing(x: NDArray[np.float64], y: NDArray[np.float64], level: float) -> float:
    """Abscissa at which y first falls to the level."""
    k = max(1, int(np.argmax(y <= level)))
    return float(np.interp(level, [y[k], y[k - 1]], [x[k], x[k - 1]]))


def inclination_loop(scenario: LevellingScenario, gain_scale: float = 1.0) -> Diagram:
    """The open loop as a diagram, which begins at the level posture.

    Input `attitude` (2) [rad]: the measured roll and pitch. Output `posture` (3) [rad, rad, m]:
    what the legs make of them. Roll and pitch led back to the input close the loop.

    Args:
        scenario: its ground, height and control part are used.
        gain_scale: the actuators' K over what the controller takes it for [-].
    """
    builder = DiagramBuilder()
    period, ground = scenario.control.period, np.array(scenario.ground.inclination)
    posture = _level_posture(scenario)
    geometry = scenario.geometry_as_known
    loop = add(builder, PostureLoop(posture_loop_params(scenario), period))
    feedforward = add(builder, KinematicFeedforward(geometry, period=period))
    passive = add(builder, PassiveLegSolver(geometry))
    pi = add(builder, PiController(pi_params(scenario), period=period))
    rods = LinearActuator(
        replace(scenario.machine.actuators.params, model="integrator"),
        time_step=period,
        extension=inverse_kinematics(geometry, posture, ground),
        gain_scale=gain_scale * np.array(scenario.gain_share),
    )
    actuators = add(builder, rods)
    kinematics = add(builder, ForwardKinematics(geometry))

    desired = add(builder, ConstantVectorSource(np.append(posture, np.zeros(3))), "desired")
    slope = add(builder, ConstantVectorSource(ground), "ground")
    enable = add(builder, ConstantVectorSource(np.ones(1)), "enable")
    for system in (loop, pi):
        connect(builder, enable.get_output_port(), system.GetInputPort("enable"))
    for system in (feedforward, passive, kinematics):
        connect(builder, slope.get_output_port(), system.GetInputPort("ground"))
    connect(builder, desired.get_output_port(), loop.GetInputPort("posture_desired_state"))
    for system in (feedforward, passive):
        connect(builder, loop.get_output_port(), system.GetInputPort("posture_desired_state"))
    active = passive.GetInputPort("active_desired_state")
    connect(builder, feedforward.get_output_port(), active)
    connect(builder, passive.get_output_port(), pi.GetInputPort("desired_state"))
    connect(builder, pi.get_output_port(), actuators.GetInputPort("voltage"))
    for system, name in ((pi, "measured"), (kinematics, "extension")):
        connect(builder, actuators.GetOutputPort("extension"), system.GetInputPort(name))
    builder.ExportInput(loop.GetInputPort("attitude"), "attitude")
    builder.ExportOutput(kinematics.get_output_port(), "posture")
    return builder.Build()


def _level_posture(scenario: LevellingScenario) -> NDArray[np.float64]:
    return np.array([0.0, 0.0, scenario.level_height])


def _settled(scenario: LevellingScenario, gain_scale: float) -> tuple[Diagram, Context]:
    """The open loop's diagram, at rest at the level posture."""
    diagram = inclination_loop(scenario, gain_scale)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    diagram.GetInputPort("attitude").FixValue(context, _level_posture(scenario)[:2])
    simulator.AdvanceTo(_SETTLING)
    return diagram, context
