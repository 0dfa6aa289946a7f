"""The walking chair: one declaration."""

from functools import partial

import numpy as np

from parapod.diagrams.disturbances import ON_BODIES_AND_GROUND
from parapod.diagrams.machine import Machine
from parapod.diagrams.plots import Limits
from parapod.diagrams.walking_chair.controller import make_controller
from parapod.diagrams.walking_chair.mujoco import add_mujoco_plant
from parapod.diagrams.walking_chair.plants import (
    add_kinematic_plant,
    add_multibody_plant,
    add_simulated,
    mirror,
)
from parapod.diagrams.walking_chair.ports import PARTS, PORTS
from parapod.diagrams.walking_chair.real import make_real
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.walking_chair.view import VIEW
from parapod.systems.walking_chair.geometry import BRANCHES, LEG_COUNT


def _limits(scenario: ChairScenario) -> Limits:
    """Strokes and speeds of the branches, their thrust, and the margin of the support."""
    drives = scenario.machine.drives
    low, high = np.tile(scenario.machine.geometry.leg.strokes, (LEG_COUNT, 1)).T
    speed, force, current = (
        1e-3 * drives.max_velocity_mm_s,
        drives.max_force_N,
        drives.rated_current_A,
    )
    return {
        **dict.fromkeys(("legs.position", "position_node", "truth.position"), (low, high)),
        **dict.fromkeys(("legs.velocity", "legs.velocity_command"), (-speed, speed)),
        "legs.current": (-current, current),
        "truth.force": (-force, force),
        "truth.contact_force": (0.0, None),
        "support_margin": (1e-3 * scenario.control.support_margin_mm, None),
    }


CHAIR = Machine(
    name="walking_chair",
    title="the walking chair",
    experiment="chair-walk",
    scenario=ChairScenario,
    ports=PORTS,
    parts=PARTS,
    axes={"legs": BRANCHES},
    plants={
        "multibody": partial(add_simulated, add_multibody_plant),
        "kinematic": partial(add_simulated, add_kinematic_plant),
        "mujoco": partial(add_simulated, add_mujoco_plant),
    },
    disturbances=ON_BODIES_AND_GROUND,
    feet=LEG_COUNT,
    mirror=mirror,
    controller=make_controller,
    view=VIEW,
    limits=_limits,
    resets=lambda scenario: (
        *("seed", "passenger"),
        *("machine.drives.gain_error", "machine.drives.offset_mm_s"),
    ),
    variant=lambda scenario: {"real": make_real(scenario)},
    real=make_real(ChairScenario()),
)
