"""The chair's plant of rigid bodies, with closed loops and contact."""

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort
from pydrake.systems.primitives import ZeroOrderHold

from parapod.diagrams.multibody import add_discrete_plant
from parapod.diagrams.visualization import publish, remove_visuals
from parapod.diagrams.walking_chair.model import add_chair
from parapod.diagrams.walking_chair.plant import Plant
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.wiring import add, connect, split_states
from parapod.systems.actuators.velocity_servo import VelocityServo
from parapod.systems.walking_chair.masses import Passenger
from parapod.systems.walking_chair.model import ChairModel, ChairTruth


def add_multibody_plant(
    builder: DiagramBuilder,
    scenario: ChairScenario,
    drives: VelocityServo,
    meshcat: Meshcat | None,
) -> Plant:
    """Adds the plant of rigid bodies, whose branches are held to where the drives are."""
    time_step = scenario.plant.time_step
    plant, scene_graph = add_discrete_plant(
        builder, time_step, scenario.plant.contact_approximation
    )
    model = add_chair(plant, scenario.passenger.passenger)
    force = _drive(builder, model, drives, time_step)
    truth = add(builder, ChairTruth(model))
    contact = plant.get_contact_results_output_port()
    connect(builder, contact, truth.GetInputPort("contact_results"))
    connect(builder, plant.get_body_poses_output_port(), truth.GetInputPort("body_poses"))
    if meshcat is None:
        remove_visuals(plant, scene_graph)
    else:
        publish(builder, scene_graph, meshcat, "chair")
    names = ("body_position", "body_attitude", "contact_force", "foot_height", "loop_error")
    signals = {name: truth.GetOutputPort(name) for name in names} | {"force": force}

    def stand(
        root_context: Context,
        lengths: NDArray[np.float64],
        body_position: NDArray[np.float64],
        passenger: Passenger,
    ) -> None:
        context = plant.GetMyMutableContextFromRoot(root_context)
        model.stand(context, lengths, body_position, passenger)

    def seat(root_context: Context, passenger: Passenger) -> None:
        model.seat(plant.GetMyMutableContextFromRoot(root_context), passenger)

    return Plant(signals, stand, seat)


def _drive(
    builder: DiagramBuilder, model: ChairModel, drives: VelocityServo, time_step: float
) -> OutputPort:
    """Connects the drives to the branches' joints; returns the force with which they hold (12).

    That force is the one of the step before: drives measure it, and what they are told next may
    depend on it.
    """
    plant = model.plant
    # One step ahead: the plant's implicit drives then arrive where the servos will be.
    ahead = split_states(
        builder, "leg_states", drives.GetOutputPort("next_state"), len(model.legs)
    )
    for port, leg in zip(ahead, model.legs, strict=True):
        connect(builder, port, plant.get_desired_state_input_port(leg))
    held = add(builder, ZeroOrderHold(time_step, plant.num_actuators()), "holding_force")
    connect(builder, plant.get_net_actuation_output_port(), held.get_input_port())
    return held.get_output_port()
