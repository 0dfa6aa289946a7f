"""The platform's controller with its defaults levels plants that are not parapod's."""

import math

import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from pydrake.systems.framework import BasicVector, LeafSystem

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.diagrams.levelling_platform.scenario import GroundScenario, LevellingScenario
from parapod.systems.core.physics import STANDARD_GRAVITY
from parapod.systems.levelling_platform.kinematics import forward_kinematics

# How far the soft side goes down under a mass, and how fast [rad/kg, s].
_SOFT, _SINKING = math.radians(0.4) / 75.0, 1.0
# Share of it about roll and pitch [-].
_SIDE = np.array((1.0, -0.5))


class SinkingPlatform(LeafSystem):
    """Four perfect actuators under a mass that is set down at the beginning on soft ground.

    It tilts until the ground holds it, too slowly for the attitude's estimator to take it for a
    motion. Its sensors are exact.
    """

    def __init__(self, mass, ground):
        super().__init__()
        self.ground, self.sinks = ground, mass * _SOFT * _SIDE
        self.voltage = self.DeclareVectorInputPort("legs.voltage", 4)
        rods = self.DeclareContinuousState(BasicVector([0.410] * 4))
        self.DeclareStateOutputPort("legs.extension", rods)
        for name, calc in (
            ("truth.posture", self.calc_posture),
            ("imu.accel", self.calc_accel),
            ("imu.gyro", self.calc_gyro),
        ):
            self.DeclareVectorOutputPort(
                name, 3, calc, {self.all_state_ticket(), self.time_ticket(), self.voltage.ticket()}
            )

    def DoCalcTimeDerivatives(self, context, derivatives):
        derivatives.get_mutable_vector().SetFromVector(0.01 * self.voltage.Eval(context))

    def posture(self, time, rods):
        posture = forward_kinematics(DRAWN, rods, self.ground, legs=(0, 1, 2))
        return posture + np.array([*self.sinks, 0.0]) * math.exp(-time / _SINKING)

    def calc_posture(self, context, output):
        rods = context.get_continuous_state_vector().CopyToVector()
        output.SetFromVector(self.posture(context.get_time(), rods))

    def calc_accel(self, context, output):
        roll, pitch, _ = self.GetOutputPort("truth.posture").Eval(context)
        R_WB = RollPitchYaw(roll, pitch, 0.0).ToRotationMatrix()
        output.SetFromVector(R_WB.inverse() @ [0.0, 0.0, STANDARD_GRAVITY])

    def calc_gyro(self, context, output):
        step, now = 1e-4, context.get_time()
        rods = context.get_continuous_state_vector().CopyToVector()
        rate = 0.01 * self.voltage.Eval(context)
        before, after = (self.posture(now + d, rods + d * rate) for d in (-step, step))
        roll, (p, q, _) = before[0], (after - before) / (2.0 * step)
        output.SetFromVector([p, q * math.cos(roll), -q * math.sin(roll)])


@pytest.mark.parametrize("mass", [20.0, 40.0, 75.0, 120.0])
@pytest.mark.parametrize("ground", [(-4.0, 1.0), (2.0, 3.0), (0.0, -3.0)])
def test_a_mass_that_sinks_is_levelled_once_its_attitude_has_settled(record, mass, ground):
    scenario = LevellingScenario(backend="kinematic", ground=GroundScenario(*ground))
    scenario.job.waypoints = []
    plant = SinkingPlatform(mass, np.radians(ground))
    names = ("truth.posture", "ground_estimated", "ground_valid", "attitude_estimated")
    loop = ClosedLoop(PLATFORM, scenario, plant=plant, log=names)
    signals = record(loop, scenario.job.estimate_at + 12.0)
    valid = signals["ground_valid"][:, 0] > 0.5
    assert valid[-1]
    found = np.degrees(signals["ground_estimated"][-1])
    posture = np.degrees(signals["truth.posture"][:, :2])
    attitude = np.degrees(signals["attitude_estimated"])
    np.testing.assert_allclose(found, ground, rtol=0.0, atol=0.1)
    np.testing.assert_allclose(attitude[valid], posture[valid], rtol=0.0, atol=0.1)
    np.testing.assert_allclose(posture[-1], 0.0, rtol=0.0, atol=0.1)
