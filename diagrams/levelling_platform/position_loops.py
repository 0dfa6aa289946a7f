"""Position loops of the platform's actuators: their design, and how legs follow by it."""

import math

import numpy as np

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.systems.actuators.linear_actuator import LinearActuatorParams
from parapod.systems.actuators.pi_controller import PiControllerParams
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.vectors import Array

# Legs follow their references within a millimetre; tracking errors above this share of their way
# mean a failed encoder [-].
_ERROR_LIMIT = 0.25
# Least damping of the position loops: with less they ring [-].
_LEAST_DAMPING = 0.1


def pi_params(scenario: LevellingScenario) -> PiControllerParams:
    """Design of the actuators' position controllers.

    Raises:
        ScenarioError: a period that is too long for the pole.
    """
    control, actuators = scenario.tuned_control, scenario.machine.actuators
    pole, limit, friction = control.pole, control.voltage_limit, control.friction_feedforward
    assert pole is not None
    assert limit is not None
    assert friction is not None
    if control.period > (longest := longest_period(pole, actuators.time_constant_ms / 1e3)):
        raise ScenarioError(
            f"control.period = {control.period:g} s is too long for control.pole = "
            f"{pole:g} rad/s, the position loops would ring: it must be "
            f"{1e-4 * math.floor(1e4 * longest):g} s or less",
            "control.period",
        )
    extending, retracting = friction
    params = actuators.params
    return PiControllerParams(
        gain=params.gain,
        pole=pole,
        voltage_limit=limit,
        rate_feedforward=control.rate_feedforward,
        friction_feedforward=(extending, retracting),
        error_limit=_ERROR_LIMIT * (params.stop_max - params.stop_min),
        gain_share=scenario.gain_share,
    )


def longest_period(pole: float, tau: float = LinearActuatorParams().time_constant) -> float:
    """Longest sampling period with which position loops do not ring [s].

    Args:
        pole: pole of the loops [rad/s].
        tau: time constant of the actuators [s].
    """
    low, high = 0.0, 1.0
    while high - low > 1e-6:
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if _damping(pole, middle, tau) >= _LEAST_DAMPING else (low, middle)
        )
    return low


def _damping(pole: float, period: float, tau: float) -> float:
    """Smallest damping of a sampled position loop, Eqs. (17) and (32)."""
    poles = np.log(np.linalg.eigvals(_loop(pole, period, tau)).astype(complex))
    return float((-poles.real / np.abs(poles)).min())


def loop_response(scenario: LevellingScenario, z: complex) -> complex:
    """Factor by which a leg's position follows samples z^k of what it is asked for [-].

    Their rates, which are fed forward, are those of the samples before and after.

    Args:
        scenario: its `control` and `machine` are used.
        z: ratio of two samples.
    """
    control = scenario.tuned_control
    pole, period = control.pole, control.period
    assert pole is not None
    loop = _loop(pole, period, scenario.machine.actuators.time_constant_ms / 1e3)
    rate = control.rate_feedforward * (z - 1.0 / z) / (2.0 * period)
    by_reference = np.array([0.0, 0.0, pole**2 * period, 2.0 * pole + rate])
    response: complex = np.linalg.solve(z * np.eye(4) - loop, by_reference)[0]
    return response


def _loop(pole: float, period: float, tau: float) -> Array:
    """Matrix (4, 4) of a sampled position loop from one sample to the next.

    The actuator is K / (s (tau s + 1)), and a command takes effect a period after its measurement.
    The state is position, velocity, integral and the command that takes effect next.
    """
    decay = math.exp(-period / tau)
    way = tau * (1.0 - decay)
    k_v, k_i = 2.0 * pole, pole**2 * period  # of u = K times the voltage
    return np.array(
        [
            [1.0, way, 0.0, period - way],
            [0.0, decay, 0.0, 1.0 - decay],
            [-k_i, 0.0, 1.0, 0.0],
            [-k_v, 0.0, 1.0, 0.0],
        ]
    )
