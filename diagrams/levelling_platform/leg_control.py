"""Controller of experiments that lead the legs themselves, simulated or on the real machine."""

from pydrake.systems.framework import Diagram
from pydrake.systems.primitives import Adder

from parapod.diagrams.levelling_platform.controller import measuring_systems
from parapod.diagrams.levelling_platform.position_loops import pi_params
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.wiring import Wired, named, wired
from parapod.systems.actuators.pi_controller import PiController
from parapod.systems.levelling_platform.eased_legs import EasedLegs
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.leg_motion import ContactKeeper


def make_leg_controller(
    scenario: LevellingScenario,
    rate: float,
    *,
    keeps_contact: bool = False,
    has_voltage: bool = False,
) -> Diagram:
    """Wires eased legs, position controllers and attitude estimator.

    Inputs: `legs.extension` (4), `imu.gyro` (3), `imu.accel` (3), `extension_request` (8) and
    `legs_enable` (1); `legs.limits` (12) where feet are kept on the ground, and
    `voltage_request` (4), which is added, where there are voltages.
    Outputs: `legs.voltage` (4), `extension_desired_state` (8), `legs_arrived` (1),
    `attitude_estimated` (2); and `feet_standing` (4) where feet are kept on the ground.

    While `legs_enable` is off the legs get 0 V, or the voltages that are asked for, and stand by
    themselves: they are self-locking.

    Args:
        scenario: its `control` part is used.
        rate: largest rate of a leg that is led to a request [m/s].
        keeps_contact: true if the passive leg is trimmed until all feet touch.
        has_voltage: true if the controller takes voltages.
    """
    control, enabled = scenario.control, {"enable": "legs_enable"}
    measuring, names = measuring_systems(control)
    outputs = ["legs.voltage", "extension_desired_state", "legs_arrived", "attitude_estimated"]
    eased, voltage = dict(enabled), dict(enabled)
    more: list[Wired] = []
    if keeps_contact:
        eased["extension_desired_state"] = "extension_eased_state"
        trims = {
            "extension_desired_state": "extension_eased_state",
            "extension_trimmed_state": "extension_desired_state",
            "enable": "legs_arrived",
            "standing": "feet_standing",
        }
        more.append((ContactKeeper(period=control.period), trims))
        outputs.append("feet_standing")
    if has_voltage:
        voltage["voltage"] = "voltage_controlled"
        total = {"u0": "voltage_controlled", "u1": "voltage_request", "sum": "legs.voltage"}
        more.append((named("voltages", Adder(2, LEG_COUNT)), total))
    systems = [
        *measuring,
        (EasedLegs(rate, control.period), eased),
        (PiController(pi_params(scenario), period=control.period), voltage),
        *more,
    ]
    return wired("controller", systems, outputs, names)
