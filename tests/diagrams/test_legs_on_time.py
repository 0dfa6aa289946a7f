"""The legs of the simulated bodies are where the actuators are, at the same instant."""

import numpy as np
import pytest

from parapod.diagrams.levelling_platform.scenario import LevellingScenario, PlantScenario
from parapod.systems.levelling_platform.leg import swing_angle

TIME_STEP = 1e-3


def extension_of(model, leg, context):
    """Extension of an actuator that the joints of its leg show [m]."""
    instance = model.legs[leg]
    if model.is_full:
        return model.plant.GetJointByName("extension", instance).get_translation(context)
    angle = model.plant.GetJointByName("swing", instance).get_angle(context)
    extensions = np.linspace(0.38, 0.46, 801)
    angles = np.array([swing_angle(model.geometry.legs[leg], d) for d in extensions.tolist()])
    order = np.argsort(angles)
    return float(np.interp(angle, angles[order], extensions[order]))


@pytest.mark.parametrize("voltage", [4.0, -4.0])
@pytest.mark.parametrize("leg_model", ["full", "reduced"])
def test_moving_legs_trail_their_actuators_by_no_step(make_machine, leg_model, voltage):
    plant = PlantScenario(time_step=TIME_STEP, leg_model=leg_model)
    machine = make_machine(LevellingScenario(plant=plant))
    machine.set("legs.voltage", voltage)
    machine.run(0.3)
    station, root = machine.station, machine.context
    model = station.behind.handle.plant.model
    actuators = station.GetSubsystemByName("linear_actuator")
    context = model.plant.GetMyContextFromRoot(root)
    extension, velocity = (
        actuators.GetOutputPort(name).Eval(actuators.GetMyContextFromRoot(root))
        for name in ("extension", "velocity")
    )
    found = np.array([extension_of(model, leg, context) for leg in range(4)])
    a_step = TIME_STEP * velocity
    assert np.abs(a_step).min() > 3e-5
    # What the rods give way by under their loads is a fifth of a step.
    steps_late = (extension - found) @ a_step / (a_step @ a_step)
    assert abs(steps_late) < 0.3
