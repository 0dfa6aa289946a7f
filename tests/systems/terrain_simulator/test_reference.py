"""The reference on ports: what the walk has at an instant, and in the middle of periods."""

import numpy as np
import pytest

from parapod.systems.terrain_simulator import reference
from parapod.systems.terrain_simulator.gait import Gait
from parapod.systems.terrain_simulator.path import PlatePath
from parapod.systems.terrain_simulator.reference import TerrainReference
from parapod.systems.terrain_simulator.terrain import Slope
from parapod.systems.terrain_simulator.walk import BenchWalk

PERIOD = 0.002
WALK = BenchWalk(PlatePath(Slope(0.2), Gait(0.8), 0.562, 0.26), 30.0, 0.58, run_up=0)


def shown(system, time):
    """Every output at a time, by its name."""
    context = system.CreateDefaultContext()
    context.SetTime(time)
    ports = [system.get_output_port(i) for i in range(system.num_output_ports())]
    return {port.get_name(): port.Eval(context) for port in ports}


@pytest.mark.parametrize("periods", [0.0, 700.0, 700.5, 1023.0, 1024.0, 1500.5, 333.37])
def test_outputs_are_those_of_the_walk_the_pose_a_period_later(periods):
    time = PERIOD * periods
    found, now = shown(TerrainReference(WALK, PERIOD), time), WALK.at(time)
    expected = {
        "pose_asked": WALK.at(time + PERIOD).pose[0],
        "plate_motion": now.pose.ravel(),
        "foot_desired": now.foot.ravel(),
        "foot_force_desired": now.force,
        "hip_force": now.hip_force,
        "hip_desired": (WALK.hip[1] + now.bounce[0], now.bounce[1]),
        "belt_velocity": now.belt,
        "stance": now.stance,
        "distance": now.distance[0],
        "rise": now.rise[0],
        "done": time >= WALK.duration,
    }
    assert set(found) == set(expected)
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], np.ravel(value), atol=1e-11, err_msg=name)


def test_a_microsecond_after_an_instant_nothing_is_computed_anew(monkeypatch):
    """Then devices are commanded: a walk computed there would take most of a tick."""
    system, calls, computed = TerrainReference(WALK, PERIOD), [], reference._rows
    before = {k: shown(system, k * PERIOD) for k in (10, 10.5)}
    monkeypatch.setattr(reference, "_rows", lambda *args: calls.append(args) or computed(*args))
    for k, values in before.items():
        for name, value in shown(system, k * PERIOD + 1e-6).items():
            np.testing.assert_array_equal(value, values[name])
    assert not calls
    shown(system, 10.2 * PERIOD)
    assert calls
