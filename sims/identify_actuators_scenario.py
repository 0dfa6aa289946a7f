"""Typed scenario of the experiment `identify-actuators`, and the voltages that it asks for."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.levelling_platform.scenario import (
    ActuatorScenario,
    LevellingScenario,
    PlantScenario,
    SensorScenario,
)
from parapod.sims.driven_machine import on_level_ground
from parapod.systems.actuators.linear_actuator import LinearActuatorParams
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.levelling_platform.geometry import LEG_COUNT

BACKENDS = ("multibody",)
NOMINAL = LinearActuatorParams().gain  # K of Eq. (18) [(m/s)/V]
STROKE = (0.385, 0.425)  # where the feet carry and the leg model holds [m]
_FEWEST_SAMPLES = 5  # that make a ramp


@dataclass
class StepsScenario(Schema):
    """The voltage steps.

    Attributes:
        voltages: voltages of the ten steps; positive ones extend the actuators, which lowers the
            platform [V].
        travel_mm: way of a nominal actuator in each step, so that small voltages last longer [mm].
        rest_s: time at 0 V before, between and after the steps [s].
        transient_s: beginning of each step that does not count for its slope [s].
        initial_extension_mm: extension of all legs at the beginning [mm].
        period: period of the log [s].
    """

    voltages: list[float] = quantity(
        [0.75, -1.0, 1.25, -1.5, 1.75, -2.0, 2.25, -2.5, 2.75, -3.0], -12.0, 12.0, length=10
    )
    travel_mm: float = quantity(12.0, 2.0, 30.0)
    rest_s: float = quantity(0.3, 0.1, 5.0)
    transient_s: float = quantity(0.1, 0.0, 1.0)
    initial_extension_mm: float = quantity(396.0, 390.0, 420.0)
    period: float = quantity(0.01, 0.001, 0.05)


def _similar_actuators() -> ActuatorScenario:
    return ActuatorScenario(gain_error=0.025)


@dataclass
class IdentifyActuatorsScenario(Schema):
    """One identification of the four actuators.

    The steps move the actuators first with the legs lifted, then under the platform's weight:
    section 5.2, Figs. 13 to 15. The paper finds each step's K within 15 % of 0.01: friction, load
    and the legs' differences together. Friction and load alone take 11.2 % of the smallest step
    that lifts, and unequal legs share the load unequally. With gains that are off by up to 3 % the
    largest deviation of 200 seeds is 14.9 %, with 4 % one seed in twelve exceeds 15 %:
    `actuators.gain_error` is 0.025.

    Attributes:
        backend: plant that carries the load: "multibody".
        seed: seed of the errors of gains and dimensions.
        steps: see `StepsScenario`.
        plant: see `PlantScenario`; it carries the load.
        actuators: see `ActuatorScenario`.
        encoder_resolution_mm: one count of the actuators' encoders [mm]; 0 for perfect ones.
    """

    backend: str = choice("multibody", BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    steps: StepsScenario = field(default_factory=StepsScenario)
    plant: PlantScenario = field(default_factory=PlantScenario)
    actuators: ActuatorScenario = field(default_factory=_similar_actuators)
    encoder_resolution_mm: float = quantity(0.01, 0.0, 1.0)

    @property
    def machine(self) -> LevellingScenario:
        """The machine on level ground."""
        sensors = SensorScenario(encoder_resolution_mm=self.encoder_resolution_mm)
        return on_level_ground(self, sensors, self.steps.initial_extension_mm)


def schedule(steps: StepsScenario) -> PiecewisePolynomial:
    """Voltage over time, constant between the knots; the last knot is the end."""
    times, values = [0.0], [0.0]
    now = steps.rest_s
    for voltage in steps.voltages:
        times += [now, now + _duration(steps, voltage)]
        values += [voltage, 0.0]
        now = times[-1] + steps.rest_s
    knots = [*times, now]
    return PiecewisePolynomial.ZeroOrderHold(knots, [[*values, 0.0]] * LEG_COUNT)


def check_steps(scenario: IdentifyActuatorsScenario) -> None:
    """Refuse steps that leave the stroke, have no ramp, or leave friction and K together.

    Raises:
        ScenarioError: names the key.
    """
    steps = scenario.steps
    extension = 1e-3 * steps.initial_extension_mm
    for i, voltage in enumerate(steps.voltages):
        key = f"steps.voltages.{i}"
        if voltage == 0.0:
            raise ScenarioError(f"{key} = 0 is no step", key)
        if abs(voltage) > scenario.actuators.supply_voltage:
            supply = scenario.actuators.supply_voltage
            raise ScenarioError(f"{key} = {voltage:g} V is above the supply, {supply:g} V", key)
        lasts = _duration(steps, voltage)
        if lasts - steps.transient_s < _FEWEST_SAMPLES * steps.period:
            why = f"lasts {lasts:.3g} s, which leaves no ramp after steps.transient_s"
            raise ScenarioError(f"{key} = {voltage:g} V {why}", key)
        extension += NOMINAL * voltage * lasts
        if not STROKE[0] <= extension <= STROKE[1]:
            low, high = (1e3 * limit for limit in STROKE)
            why = f"would bring the legs to {1e3 * extension:.1f} mm, outside {low:g}..{high:g} mm"
            raise ScenarioError(f"{key} = {voltage:g} V {why}", key)
    # K and friction are separable only if one direction has two voltages.
    if len(set(steps.voltages)) == len(set(np.sign(steps.voltages))):
        why = "has one voltage a direction, which does not tell K from friction"
        raise ScenarioError(f"steps.voltages {why}", "steps.voltages")


def _duration(steps: StepsScenario, voltage: float) -> float:
    """Duration of a step, in whole samples of the log [s]."""
    exact = 1e-3 * steps.travel_mm / (NOMINAL * abs(voltage))
    return max(1, round(exact / steps.period)) * steps.period
