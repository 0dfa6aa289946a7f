"""The outer inclination loop behind a sensor that vibrates."""

from functools import cache

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Adder

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.station import Station
from parapod.systems.core.ports import value_of
from parapod.systems.core.scenario_file import load_scenario

SETTINGS = (
    "backend=kinematic",
    "ground={roll_deg: 0.3, pitch_deg: -0.4}",
    "control.outer_loop=true",
    "job={estimate_at: 2, settled_after: 3, end: 15, waypoints: []}",
    "job.arm={start: 0, duration: 1, angle_deg: 0}",
)
CALM, SHAKEN, OVER = 8.0, 13.0, 27.0


class Vibration(LeafSystem):
    """Knocks from one side, which a filter takes for a slope: their mean is not zero [m/s2]."""

    def __init__(self, size):
        super().__init__()
        self.size = size
        self.DeclareVectorOutputPort("knocks", 3, self._calc, {self.time_ticket()})

    def _calc(self, context, output):
        time = context.get_time()
        knock = CALM <= time < SHAKEN and round(time / 0.01) % 2
        output.SetFromVector(np.array([0.0, self.size if knock else 0.0, 0.0]))


def shaken(scenario, size):
    """A station whose accelerometer feels knocks besides."""
    builder = DiagramBuilder()
    station = builder.AddSystem(Station(PLATFORM, scenario))
    sum_ = builder.AddSystem(Adder(2, 3))
    builder.Connect(station.GetOutputPort("imu.accel"), sum_.get_input_port(0))
    builder.Connect(builder.AddSystem(Vibration(size)).get_output_port(), sum_.get_input_port(1))
    for i in range(station.num_input_ports()):
        builder.ExportInput(station.get_input_port(i), station.get_input_port(i).get_name())
    for i in range(station.num_output_ports()):
        port = station.get_output_port(i)
        is_shaken = port.get_name() == "imu.accel"
        builder.ExportOutput(sum_.get_output_port() if is_shaken else port, port.get_name())
    return builder.Build()


@pytest.fixture(scope="module")
def inclination():
    """inclination(size): furthest from level in each stage [deg], and of the estimate."""

    @cache
    def run(size):
        scenario = load_scenario(LevellingScenario, overrides=SETTINGS)
        loop = ClosedLoop(PLATFORM, scenario, plant=shaken(scenario, size), log=())
        simulator = Simulator(loop)
        context = simulator.get_context()
        true, estimated = [], []
        for time in np.arange(0.1, OVER, 0.1):
            simulator.AdvanceTo(time)
            true.append(value_of(loop.station, "truth.posture", context)[:2])
            estimated.append(value_of(loop.controller, "attitude_estimated", context))
        time = np.arange(0.1, OVER, 0.1)
        stages = (
            (time > CALM - 2) & (time < CALM),
            (time > CALM) & (time < SHAKEN),
            time > OVER - 2,
        )
        return [
            [np.degrees(np.abs(np.array(angle)[stage]).max()) for stage in stages]
            for angle in (true, estimated)
        ]

    return run


def test_knocks_mislead_the_attitude_and_not_the_platform(inclination):
    calm, _ = inclination(0.0)
    true, estimated = inclination(2.0)
    assert estimated[1] > 1.0  # what the loop would follow
    assert true[1] == pytest.approx(calm[1], abs=0.03)
    assert true[2] < calm[2] + 0.05  # and corrects again once they are over


def test_knocks_that_cannot_be_told_from_noise_change_little(inclination):
    calm, _ = inclination(0.0)
    true, _ = inclination(0.05)
    assert true[1] < calm[1] + 0.2
