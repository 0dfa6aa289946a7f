"""How long a sign persists before the fault detector believes it."""

import math

import numpy as np
import pytest

from parapod.systems.levelling_platform.fault_detection import FaultDetector, Finding
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.supervisor import Phase

PERIOD = 0.01
POSTURE = (0.0, 0.0, 0.485)
EXTENSION = inverse_kinematics(MODEL_GEOMETRY, POSTURE, (0.0, 0.0))
AT_REST = {
    "extension": EXTENSION,
    "limits": np.repeat((0.0, 1.0), (8, 4)),
    "voltage": np.zeros(4),
    "gyro": np.zeros(3),
    "accel": (0.0, 0.0, 9.81),
    "age": np.zeros(4),
    "attitude": np.zeros(2),
    "ground": np.zeros(2),
    "foot_offsets": np.zeros(4),
    "posture_request": POSTURE,
    "operator": (0.0,),
    "phase": (float(Phase.HOLD),),
}
TILT = math.radians(20.0)


@pytest.mark.parametrize(
    ("finding", "seconds", "inputs"),
    [
        (Finding.ENCODER_INVALID, 0.0, {"extension": (*EXTENSION[:3], math.nan)}),
        (Finding.LEGS_STALE, 0.0, {"age": (1.0, 0.0, 0.0, 0.0)}),
        (Finding.IMU_STALE, 0.0, {"age": (0.0, 1.0, 0.0, 0.0)}),
        (Finding.COMMAND_INVALID, 0.0, {"posture_request": (math.nan, 0.0, 0.485)}),
        (Finding.GYRO_INVALID, 0.05, {"gyro": (0.0, 0.0, math.inf)}),
        (Finding.SWITCH_END, 0.1, {"limits": np.repeat((1.0, 0.0, 1.0), (1, 7, 4))}),
        (Finding.ACCEL_INVALID, 0.15, {"accel": (0.0, 0.0, 0.0)}),
        (Finding.FEET_MISMATCH, 0.2, {"foot_offsets": (9e-3, -9e-3, 9e-3, -9e-3)}),
        (Finding.POSTURE_MISMATCH, 0.3, {"ground": (0.2, 0.0)}),
        (
            Finding.ACCEL_MISMATCH,
            0.4,
            {"accel": (0.0, 9.81 * math.sin(TILT), 9.81 * math.cos(TILT))},
        ),
        (Finding.FOOT_LOST, 0.8, {"limits": np.repeat((0.0, 1.0, 0.0), (8, 3, 1))}),
    ],
    ids=lambda value: value.name if isinstance(value, Finding) else "",
)
def test_a_sign_is_believed_when_it_has_lasted_and_not_before(finding, seconds, inputs):
    detector = FaultDetector(MODEL_GEOMETRY, period=PERIOD)
    context = detector.CreateDefaultContext()

    def tick(given):
        for name, value in given.items():
            detector.GetInputPort(name).FixValue(context, np.array(value))
        ahead = detector.EvalUniquePeriodicDiscreteUpdate(context)
        values = [ahead.value(i).copy() for i in range(ahead.num_groups())]
        context.SetTime(context.get_time() + PERIOD)
        for i, value in enumerate(values):
            context.SetDiscreteState(i, value)
        return detector.GetOutputPort("findings").Eval(context)[finding] > 0.5

    # Feet that touch after the beginning have an attitude from before.
    tick(AT_REST | {"limits": np.zeros(12)})
    assert not any(tick(AT_REST) for _ in range(100))
    later = [tick(AT_REST | inputs) for _ in range(100)]
    assert later.index(True) == round(seconds / PERIOD)
