import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.walking_chair.gait import TrotGait, Walk
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.masses import Passenger
from parapod.systems.walking_chair.support import GaitSupport, SupportMonitor, SupportMonitorParams

WALK = Walk((TrotGait(),))
MARGINS = GaitSupport(ChairGeometry(), WALK).margins


def start(fix, payload, gait_time=0.0, **params):
    monitor = SupportMonitor(WALK, SupportMonitorParams(**params), period=0.1)
    simulator = Simulator(monitor)
    context = simulator.get_mutable_context()
    fix(monitor, context, gait_time=(gait_time,), payload=payload)
    return monitor, simulator, context


def shown(monitor, context, name):
    return monitor.GetOutputPort(name).Eval(context)[0]


@pytest.mark.parametrize(("time", "phases"), [(1.0, (0, 1)), (6.0, (1, 2)), (11.0, (2, 3))])
def test_margin_is_the_smallest_of_this_phase_and_the_next(fix, time, phases):
    passenger = Passenger(57.0, 0.05, 0.02)
    monitor, _, context = start(fix, (57.0, 0.05, 0.02), time)
    expected = MARGINS(passenger)[list(phases)].min()
    assert shown(monitor, context, "margin") == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("time", [-1.0, 23.0, 25.0, 60.0])
def test_before_and_after_the_walk_its_ends_count(fix, time):
    monitor, _, context = start(fix, (57.0, 0.0, 0.0), time)
    margins = MARGINS(Passenger(57.0))
    expected = margins[:2].min() if time < 0.0 else margins[-1]
    assert shown(monitor, context, "margin") == pytest.approx(expected, abs=1e-12)


def test_too_little_margin_holds_the_gait(fix):
    monitor, simulator, context = start(fix, (57.0, 0.0, 0.0))
    simulator.AdvanceTo(0.15)
    assert shown(monitor, context, "hold") == 0.0
    fix(monitor, context, payload=(57.0, 0.10, 0.05))
    simulator.AdvanceTo(0.35)
    assert shown(monitor, context, "margin") < 0.0
    assert shown(monitor, context, "hold") == 1.0


def test_a_hold_ends_only_with_some_margin_more(fix):
    monitor, simulator, context = start(fix, (57.0, 0.0, 0.0), required=0.03, regained=0.01)
    edge = [x for x in np.linspace(0.0, 0.1, 2001) if MARGINS(Passenger(57.0, x))[1] >= 0.03][-1]
    holds = []
    for k, x in enumerate((edge + 1e-3, edge - 1e-3, edge - 0.03)):
        fix(monitor, context, payload=(57.0, x, 0.0))
        simulator.AdvanceTo(0.05 + 0.2 * (k + 1))
        holds.append(shown(monitor, context, "hold"))
    assert holds == [1.0, 1.0, 0.0]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("index", [0, 1, 2])
def test_a_payload_that_is_not_finite_holds_the_gait(fix, index, bad):
    payload = np.array((57.0, 0.0, 0.0))
    payload[index] = bad
    monitor, simulator, context = start(fix, payload)
    simulator.AdvanceTo(0.15)
    assert shown(monitor, context, "margin") == -math.inf
    assert shown(monitor, context, "hold") == 1.0


@pytest.mark.parametrize("change", [{"gait_time": (21.0,)}, {"payload": (57.0, 0.02, 0.0)}])
def test_each_input_moves_the_margin(moved, fix, change):
    monitor, _, context = start(fix, (57.0, 0.0, 0.0))
    assert moved(monitor, context, lambda: fix(monitor, context, **change)) == {"margin"}
