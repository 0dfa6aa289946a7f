"""Plant of the walking chair whose rigid bodies MuJoCo simulates."""

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, DiagramBuilder

from parapod.diagrams.disturbances import rising_ground
from parapod.diagrams.drawing import publish
from parapod.diagrams.mujoco import draw, make_plant
from parapod.diagrams.pads import PADS
from parapod.diagrams.pushes import places_of, push_mujoco, pushes_in
from parapod.diagrams.walking_chair.plants import Beginning, ChairPlant, add_designed_chair
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.wiring import add, connect, first_of, joined
from parapod.systems.actuators.velocity_servo import VelocityServo
from parapod.systems.physics.mujoco.model import MujocoModel
from parapod.systems.physics.mujoco.plant import MujocoPlant
from parapod.systems.walking_chair.geometry import BRANCHES, LEG_COUNT
from parapod.systems.walking_chair.masses import Passenger
from parapod.systems.walking_chair.model import ChairTruth


def add_mujoco_plant(
    builder: DiagramBuilder,
    scenario: ChairScenario,
    beginning: Beginning,
    drives: VelocityServo,
    meshcat: Meshcat | None,
) -> ChairPlant:
    """Adds the plant of rigid bodies; translated from Drake's, so that both are one machine.

    Raises:
        MissingExtra: MuJoCo is not installed.
    """
    plant, scene_graph = make_plant(builder, scenario.plant.time_step, meshcat)
    rising = rising_ground(builder, scenario.disturbances, LEG_COUNT)
    giving = None if rising is None else scene_graph
    model = add_designed_chair(plant, scenario, beginning.passenger, giving)
    plant.SetDefaultPositions(model.standing_positions(beginning.lengths, beginning.body))
    translated = MujocoModel(
        plant, scene_graph, model.balls, feet=model.feet, loads=(model.passenger,)
    )
    exchanged = (model.passenger,)
    pushed = pushes_in(builder, plant, scenario.disturbances, model.body, exchanged)
    groups, leading = [model.legs], [drives.GetOutputPort("next_state")]
    truth = add(builder, ChairTruth(model))
    if rising is not None:
        groups.append((plant.GetModelInstanceByName(PADS),))
        leading.append(rising)
        connect(builder, rising, truth.GetInputPort("rising"))
    bodies = add(builder, MujocoPlant(translated, groups, pushed=places_of(pushed)))
    push_mujoco(builder, bodies, pushed, meshcat)
    desired = joined(builder, leading, "desired_state")
    connect(builder, desired, bodies.GetInputPort("desired_state"))
    connect(builder, bodies.GetOutputPort("body_poses"), truth.GetInputPort("body_poses"))
    if meshcat is not None:
        draw(builder, bodies, scene_graph)
        publish(builder, scene_graph, meshcat, "chair")
    names = ("body_position", "body_attitude", "foot_height", "loop_error")
    signals = {name: truth.GetOutputPort(name) for name in names}
    signals["contact_force"] = bodies.GetOutputPort("contact_force")
    force = bodies.GetOutputPort("holding_force")
    signals["force"] = first_of(builder, force, len(BRANCHES), "branch_forces")

    def stand(root_context: Context, beginning: Beginning) -> None:
        context = plant.CreateDefaultContext()
        model.stand(context, beginning.lengths, beginning.body, beginning.passenger)
        bodies.put(bodies.GetMyMutableContextFromRoot(root_context), context)

    def seat(root_context: Context, passenger: Passenger) -> None:
        context = plant.CreateDefaultContext()
        model.seat(context, passenger)
        bodies.load(bodies.GetMyMutableContextFromRoot(root_context), context)

    return ChairPlant(signals, stand, seat=seat)
