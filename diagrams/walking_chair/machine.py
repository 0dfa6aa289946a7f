"""The walking chair: one declaration."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from parapod.diagrams.machine import Machine
from parapod.diagrams.plots import Limits
from parapod.diagrams.real import MachineView, RealMachine, SelfTest
from parapod.diagrams.walking_chair.controller import make_controller
from parapod.diagrams.walking_chair.guard import ChairGuard
from parapod.diagrams.walking_chair.homing import make_homing
from parapod.diagrams.walking_chair.mujoco import add_mujoco_plant
from parapod.diagrams.walking_chair.plants import (
    add_kinematic_plant,
    add_multibody_plant,
    add_simulated,
    mirror,
)
from parapod.diagrams.walking_chair.ports import PARTS, PORTS
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.walking_chair.twin import ChairTwin
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


# Drives are motor and screw alone: their controllers are among the devices, which count, and close
# the velocity's loop over the encoder, so that neither an error of the gain nor an offset is left.
# The lag of that loop stays, because the devices make ramps and have none.
_BY_DEVICES = {
    "machine.drives.gain_error": 0.0,
    "machine.drives.offset_mm_s": 0.0,
    "machine.drives.encoder_resolution_mm": 0.0,
}
_MOVE = SelfTest(
    command="velocity_command",
    usual=0.01,
    largest=0.02,
    measures="position",
    rest={"brake": 0.0},
)


def _variant(scenario: ChairScenario) -> Mapping[str, Any]:
    """The homing, which ends where the legs do, and the drives' limits."""
    leg = scenario.machine.geometry.leg
    retracted, extended = (1e3 * leg.strokes).round(3).T.tolist()
    ends = {"position_min_mm": retracted * LEG_COUNT, "position_max_mm": extended * LEG_COUNT}
    real = RealMachine(
        self_tests={"legs": _MOVE},
        homings={"legs": make_homing(leg)},
        fittings={"legs": ends},
        # The quasi-static plant's statics cost more than the bodies' dynamics.
        exchange={"multibody": 2e-3, "kinematic": 5e-3, "mujoco": 2e-3},
        by_devices=_BY_DEVICES,
        cut={"legs.velocity_command": 0.0, "legs.brake": 1.0},
        guard=ChairGuard,
    )
    return {"real": real}


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
    mirror=mirror,
    controller=make_controller,
    view=MachineView(
        ChairTwin,
        plots=(
            "position_node[0:3]+legs.position[0:3]",
            "support_margin",
            "truth.contact_force",
            "legs.current[0:3]",
        ),
        log_every=2,
    ),
    limits=_limits,
    resets=lambda scenario: (
        *("seed", "passenger"),
        *("machine.drives.gain_error", "machine.drives.offset_mm_s"),
    ),
    variant=_variant,
    **_variant(ChairScenario()),
)
