"""Compare Drake and MuJoCo on the platform: postures, forces, loops, convergence of the steps.

Both simulate the same bodies, drives and commands. The posture must agree, as it follows from
geometry and stiffness; so must the feet's forces, as far as statics determines them. It does not
determine how two opposite feet and the other two share the weight: legs that are a few micrometres
longer bear tens of newtons more, and actuators whose friction depends on their load come to rest a
few micrometres apart. That share is a matter of history, and is shown for itself.

Largest differences at 1 ms: posture .0059 deg and .050 mm, beyond the rods' own extensions .0019
deg and .020 mm; feet's forces, as far as statics determines them, 1.2 N (.19 N rms) of 130 N; gap
of the loops .96 um with Drake, .024 um with MuJoCo.

| step | 4 ms | 2 ms | 1 ms | .5 ms |
|---|---|---|---|---|
| angles [deg] | .0098 | .0024 | .0059 | .0014 |
| height [mm] | .21 | .065 | .050 | .010 |

* Load sharing: in motion it differs by up to 62 N a foot, and by 414 N at a rod. Actuators then
  come to rest up to 31 um apart, which is most of the difference in posture, and why it does not
  fall evenly with the step.
* Loops: Drake regularises the constraints by the step. Their gap grows from 1 um at 1 ms to 3 um
  at 2 ms, six times as much at the height. MuJoCo's loops here are springs of 1e10 N/m.
* Creep of the standing platform: Drake .019 mm/s, MuJoCo .0009 mm/s at 1 ms. MuJoCo's friction
  here is 1e4 N s/m of damping and 1e4 kg of added mass along the ground.
* Sliding feet lift in MuJoCo's convex contact, by friction times their way in a step. Here
  friction stops at a rate of 100 1/s, and at 1 ms they lift by 2 um; stopped at once they would
  chatter at 1 ms already. Up to 5 ms they are quiet; at 10 ms the platform hops 5 cm down the
  slope while it moves.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.lab.engines import EngineComparison, Floats, Quantity
from parapod.sims.levelling_platform.levelling import LevellingExperiment
from parapod.systems.core.schema import quantity
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.kinematics import forward_kinematics

_DEGREE, _LEGS = math.degrees(1.0), tuple(range(LEG_COUNT))
# Feet 1 and 3 against 2 and 4.
_OPPOSITE = np.array((1.0, -1.0, 1.0, -1.0))


@dataclass
class PlatformEnginesScenario(LevellingScenario):
    """One comparison of engines on the levelling platform; the job's keys are those of `level`.

    Attributes:
        steps_ms: steps with which both engines repeat the job [ms].
    """

    steps_ms: list[float] = quantity([4.0, 2.0, 1.0, 0.5], 0.1, 20.0)


class CompareEngines(EngineComparison[LevellingScenario], LevellingExperiment):
    """Runs the job with both engines."""

    schema = PlatformEnginesScenario
    takes = "1 min"
    signals = (
        "truth.posture",
        "truth.extension",
        "truth.load_force",
        "truth.contact_force",
        "truth.loop_error",
    )
    quantities = (
        Quantity("angle", "truth.posture", "deg", _DEGREE, "roll and pitch", (0, 1), 0.02, True),
        Quantity("height", "truth.posture", "mm", 1e3, "height", (2,), 0.3, True),
        Quantity(
            *("angle_beyond", "beyond_kinematics", "deg", _DEGREE, "angles beyond the rods'"),
            (0, 1),
            0.01,
        ),
        Quantity(
            "height_beyond", "beyond_kinematics", "mm", 1e3, "height beyond the rods'", (2,), 0.1
        ),
        Quantity(
            "contact_force",
            "determined_force",
            "N",
            1.0,
            "feet, determined",
            _LEGS,
            2.0,
            is_rough=True,
        ),
        Quantity("shared_force", "shared_force", "N", 1.0, "feet, undetermined", (0,)),
        Quantity("load_force", "truth.load_force", "N", 1.0, "rods' forces", _LEGS),
    )

    def scales(self, scenario: LevellingScenario) -> Mapping[str, float]:
        """Ways by the working height, forces by the mass."""
        machine = scenario.machine
        return {"mm": machine.size, "N": machine.masses.mass / PlatformDesign().masses.mass}

    def derived(
        self, scenario: LevellingScenario, signals: Mapping[str, Floats]
    ) -> Mapping[str, Floats]:
        """Posture beyond that of the rods; the feet's forces, as statics determines them or not.

        Lengths that add to the forces of two opposite feet what they take from the others change
        neither the forces' sum nor their moments, nearly: the feet stand on a rectangle.
        """
        rods = forward_kinematics(
            scenario.geometry_as_built,
            signals["truth.extension"],
            scenario.ground.inclination,
            legs=(0, 1, 2),
            foot_offsets=scenario.ground.foot_offsets,
        )
        force = signals["truth.contact_force"]
        shared = force @ _OPPOSITE / LEG_COUNT
        return {
            "beyond_kinematics": signals["truth.posture"] - rods,
            "determined_force": force - np.outer(shared, _OPPOSITE),
            "shared_force": shared[:, None],
        }

    def counts_from(self, scenario: LevellingScenario) -> float:
        """The beginning of the levelling [s]."""
        return scenario.job.estimate_at
