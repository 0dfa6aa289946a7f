import numpy as np

from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.leg import leg_inverse
from parapod.systems.walking_chair.planner import CircleReference
from parapod.systems.walking_chair.trajectories import FootCircle


def test_a_circle_has_a_node_every_hundredth_of_a_second_if_nobody_says_another_period():
    reference = CircleReference()
    timing = reference.GetUniquePeriodicDiscreteUpdateAttribute()
    assert (timing.period_sec(), timing.offset_sec()) == (0.01, 0.0)
    node = reference.GetOutputPort("position_node").Eval(reference.CreateDefaultContext())
    wanted = leg_inverse(LegGeometry(), FootCircle().motion(0.01).position)
    np.testing.assert_array_equal(node, wanted)
