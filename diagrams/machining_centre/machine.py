"""The machining centres, tripod and quadruped: one declaration."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from pydrake.systems.framework import System
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.disturbances import FORCES, Subsidence
from parapod.diagrams.machine import Machine, numbered
from parapod.diagrams.machining_centre.controller import make_controller
from parapod.diagrams.machining_centre.plants import (
    add_kinematic_plant,
    add_multibody_plant,
    add_simulated,
    mirror,
)
from parapod.diagrams.machining_centre.ports import PARTS, ports_of_limbs
from parapod.diagrams.machining_centre.real import CentreLimits, make_real
from parapod.diagrams.machining_centre.scenario import CentreScenario
from parapod.diagrams.machining_centre.view import VIEW
from parapod.diagrams.plots import Limits
from parapod.diagrams.wiring import named_source

# Upper bound of `stop_at` [s].
_LAST_STOP = 1e4


def _stop(scenario: CentreScenario) -> Sequence[System]:
    """Source of `stop`, if the scenario sets `stop_at`."""
    if scenario.stop_at is None:
        return ()
    instants = (-1.0, scenario.stop_at, scenario.stop_at + _LAST_STOP)
    pressed = PiecewisePolynomial.ZeroOrderHold(instants, [[0.0, 1.0, 1.0]])
    return (named_source("stop", pressed),)


def _limits(scenario: CentreScenario) -> Limits:
    """Stroke, speed and force of the legs, and how far they may be off their way."""
    geometry, legs = scenario.machine.geometry, scenario.machine.legs
    stroke = geometry.stroke_min, geometry.stroke_max
    speed, force = 1e-3 * legs.max_velocity_mm_s, legs.max_force_N
    current, off = (
        force / legs.force_per_current_N_A,
        CentreLimits.for_machine(scenario.machine).following,
    )
    return {
        **dict.fromkeys(("legs.position", "legs.position_command"), stroke),
        "legs.velocity": (-speed, speed),
        "legs.current": (-current, current),
        "truth.leg_force": (-force, force),
        "length_error": (-off, off),
    }


def _variant(scenario: CentreScenario) -> Mapping[str, Any]:
    """Sizes of the ports, and names of the legs."""
    limbs = scenario.machine.limbs
    axes = {"legs": numbered("leg", 2 * limbs)}
    ports, real = ports_of_limbs(limbs), make_real(scenario)
    return {"ports": ports, "axes": axes, "real": real, "feet": limbs}


MACHINING_CENTRE = Machine(
    name="machining_centre",
    title="the machining centre",
    experiment="centre-walk",
    scenario=CentreScenario,
    parts=PARTS,
    plants={
        "multibody": partial(add_simulated, add_multibody_plant),
        "kinematic": partial(add_simulated, add_kinematic_plant),
    },
    disturbances={"multibody": (*FORCES, Subsidence)},
    mirror=mirror,
    controller=make_controller,
    sources=_stop,
    view=VIEW,
    limits=_limits,
    resets=lambda scenario: ("seed", "machine.legs.length_error_mm"),
    variant=_variant,
    **_variant(CentreScenario()),
)
