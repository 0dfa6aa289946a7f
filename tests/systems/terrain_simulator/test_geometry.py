import math

import pytest

from parapod.systems.terrain_simulator.geometry import BenchGeometry


def test_pivots_are_where_table_2_and_figure_4_have_them():
    pedal, treadmill = BenchGeometry.pedal(), BenchGeometry.treadmill()
    assert math.dist(pedal.p_OP, pedal.p_OT) == pytest.approx(0.09, abs=1e-15)
    assert pedal.p_OT == (0.06, 0.0)
    assert pedal.p_OP[1] == pytest.approx(-0.09 * math.sin(math.radians(33.0)))
    assert treadmill.p_OP == (-0.3, 0.0)
    assert treadmill.p_OT == (0.3, 0.0)
    assert (pedal.branch, treadmill.branch) == (1.0, -1.0)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"link": 0.0}, "link must be positive, not 0.0"),
        ({"strut": math.nan}, "strut must be finite, not nan"),
        ({"gap": -0.1}, "gap must be positive, not -0.1"),
        ({"gap": 0.6}, r"gap = 0\.6 m must be less than two links, 0\.6 m"),
        ({"slider_min": 2.0}, r"slider_min = 2 m must be less than slider_max = 1\.12 m"),
        ({"offset": 1.6}, r"offset must be within \+-pi/2, not 1\.6"),
        ({"strut_gap": 0.0}, "strut_gap must be positive, not 0.0"),
    ],
)
def test_a_bench_that_cannot_be_is_refused(changed, said):
    values = {"link": 0.3, "strut": 0.4, "lever": 0.1, "plate": 0.1, "offset": 0.0}
    with pytest.raises(ValueError, match=said):
        BenchGeometry(**(values | {"strut_ahead": True} | changed))
