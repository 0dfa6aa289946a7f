"""Controller of experiments that lead the legs themselves, simulated or on the real machine."""

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Adder

from parapod.diagrams.levelling_platform.controller import Extension, add_attitude, pi_params
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.wiring import add, connect
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
    builder = DiagramBuilder()
    control = scenario.control
    extension = Extension(builder, control)
    add_attitude(builder, control)
    eased = add(builder, EasedLegs(rate, control.period))
    pi = add(builder, PiController(pi_params(scenario), period=control.period))
    extension.feed(eased.GetInputPort("extension"))
    extension.feed(pi.GetInputPort("measured"))
    builder.ExportInput(eased.GetInputPort("extension_request"), "extension_request")
    builder.ExportInput(eased.GetInputPort("enable"), "legs_enable")
    builder.ConnectInput("legs_enable", pi.GetInputPort("enable"))
    desired = eased.GetOutputPort("extension_desired_state")
    if keeps_contact:
        keeper = add(builder, ContactKeeper(period=control.period))
        connect(builder, desired, keeper.GetInputPort("extension_desired_state"))
        connect(builder, eased.GetOutputPort("legs_arrived"), keeper.GetInputPort("enable"))
        builder.ExportInput(keeper.GetInputPort("limits"), "legs.limits")
        builder.ExportOutput(keeper.GetOutputPort("standing"), "feet_standing")
        desired = keeper.GetOutputPort("extension_trimmed_state")
    connect(builder, desired, pi.GetInputPort("desired_state"))
    voltage = pi.GetOutputPort("voltage")
    if has_voltage:
        total = add(builder, Adder(2, LEG_COUNT), "voltages")
        connect(builder, voltage, total.get_input_port(0))
        builder.ExportInput(total.get_input_port(1), "voltage_request")
        voltage = total.get_output_port()
    builder.ExportOutput(voltage, "legs.voltage")
    builder.ExportOutput(desired, "extension_desired_state")
    builder.ExportOutput(eased.GetOutputPort("legs_arrived"), "legs_arrived")
    diagram = builder.Build()
    diagram.set_name("controller")
    return diagram
