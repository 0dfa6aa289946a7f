"""Lead the levelling platform's legs with an LQR on extensions and inclination.

parapod run level --set control.controller=examples/controllers/lqr_level.py:make
"""

import numpy as np
from pydrake.systems.controllers import DiscreteTimeLinearQuadraticRegulator
from pydrake.systems.framework import LeafSystem

from parapod import linearised, outputs_of, wired
from parapod.systems.levelling_platform.inclination_loop import ForwardKinematics
from parapod.systems.levelling_platform.kinematics import inverse_kinematics

# Errors that are as bad as each other: extensions [m], inclination times time [rad s], voltages.
EXTENSION, INCLINATION, VOLTAGE = 1e-3, 0.1, 1.0


def make(scenario, machine):
    """Makes the machine's own controller with other voltages."""
    ours, lqr = machine.controller(scenario), Lqr(scenario)
    systems = [(ours, {"legs.voltage": "usual_voltage"}), lqr]
    return wired("controller", systems, outputs_of(ours))


class Lqr(LeafSystem):
    """Voltages of the legs by an LQR on the linearised inclination dynamics.

    State: discrete, integrals of the errors of roll and pitch (2) [rad s].
    """

    def __init__(self, scenario):
        super().__init__()
        self.set_name("lqr")
        self.period = scenario.control.period
        self.actuator = scenario.machine.actuators.params
        self.gain = gain(scenario, self.actuator.gain, self.period)
        sizes = {"legs.extension": 4, "extension_desired_state": 8, "attitude_estimated": 2}
        sizes |= {"posture_desired_state": 6, "ground_valid": 1}
        self.signals = {name: self.DeclareVectorInputPort(name, n) for name, n in sizes.items()}
        self.DeclareDiscreteState(2)
        self.DeclarePeriodicDiscreteUpdateEvent(self.period, 0.0, self.integrate)
        self.DeclareVectorOutputPort("legs.voltage", 4, self.calc_voltage)

    def integrate(self, context, state):
        """Adds the errors of roll and pitch, once the ground is known."""
        read = {name: port.Eval(context) for name, port in self.signals.items()}
        error = read["attitude_estimated"] - read["posture_desired_state"][:2]
        before = context.get_discrete_state_vector().value()
        state.set_value(read["ground_valid"] * (before + self.period * error))

    def calc_voltage(self, context, output):
        """Feedforward of the rates, and feedback of the errors."""
        read = {name: port.Eval(context) for name, port in self.signals.items()}
        desired, rate = np.split(read["extension_desired_state"], 2)
        errors = [read["legs.extension"] - desired, context.get_discrete_state_vector().value()]
        voltage = rate / self.actuator.gain - self.gain @ np.concatenate(errors)
        limit = self.actuator.supply_voltage
        output.SetFromVector(read["ground_valid"] * np.clip(voltage, -limit, limit))


def gain(scenario, per_volt, period):
    """Gain (4, 6) of the LQR, about the level posture.

    Its states are the errors of the extensions (4) and the integrals of those of the
    inclination (2); a motor's voltage is a rate of its extension.
    """
    geometry = scenario.geometry_as_known
    kinematics = ForwardKinematics(geometry)
    context = kinematics.CreateDefaultContext()
    extension = inverse_kinematics(geometry, [0.0, 0.0, scenario.level_height], np.zeros(2))
    kinematics.GetInputPort("extension").FixValue(context, extension)
    kinematics.GetInputPort("ground").FixValue(context, np.zeros(2))
    inclination = linearised(kinematics, context, ["extension"], ["posture"]).D()[:2]
    a, b = np.eye(6), np.zeros((6, 4))
    a[4:, :4] = period * inclination
    b[:4] = period * per_volt * np.eye(4)
    q = np.diag([EXTENSION**-2] * 4 + [INCLINATION**-2] * 2)
    return DiscreteTimeLinearQuadraticRegulator(a, b, q, np.eye(4) / VOLTAGE**2)[0]
