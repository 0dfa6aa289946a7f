"""The machining centres, tripod and quadruped: one declaration."""

from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import System
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.machine import Machine
from parapod.diagrams.machining_center.controller import make_controller
from parapod.diagrams.machining_center.plants import add_bodies, add_kinematics, add_mock
from parapod.diagrams.machining_center.ports import PARTS, ports_of, ports_of_limbs
from parapod.diagrams.machining_center.scenario import CenterScenario
from parapod.diagrams.wiring import named_source

# Longest time after which somebody has a job end [s].
_LONG = 1e4


def _stop(scenario: CenterScenario) -> Sequence[System]:
    """What has the job end, where somebody is to."""
    if scenario.stop_at is None:
        return ()
    instants = np.array((-1.0, scenario.stop_at, scenario.stop_at + _LONG))
    pressed = PiecewisePolynomial.ZeroOrderHold(instants, np.array([[0.0, 1.0, 1.0]]))
    return (named_source("stop", pressed),)


MACHINING_CENTER = Machine(
    name="machining_center",
    title="the machining centre",
    experiment="center-walk",
    scenario=CenterScenario,
    ports=ports_of_limbs(CenterScenario().limbs),
    ports_of=ports_of,
    parts=PARTS,
    plants={"multibody": add_bodies, "kinematic": add_kinematics},
    mock=add_mock,
    controller=make_controller,
    sources=_stop,
)
