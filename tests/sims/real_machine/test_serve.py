"""Machines on a bus as `parapod serve` puts them there: channels, description, poses, errors."""

import io
import math
import os
import threading
import time
from zlib import crc32

import numpy as np
import pytest
from rich.console import Console

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.machine import list_machines
from parapod.sims.output.logs.files import read_log
from parapod.sims.output.options import RunOptions
from parapod.sims.real_machine.serve import serve
from parapod.systems.core.errors import MissingExtra, ParapodError, ScenarioError

MACHINES = list_machines()


def served(machine, address, duration=0.2, log=None):
    """What `serve` says of a machine whose bodies are not simulated."""
    scenario, text = machine.scenario(), io.StringIO()
    scenario.backend = "kinematic"
    options = RunOptions(console=Console(file=text, width=1000), log=log)
    timing = serve(machine, scenario, address, options, duration)
    assert timing.ticks + timing.missed >= 0.9 * duration / scenario.control.period
    return text.getvalue()


@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.name)
def test_every_machine_describes_itself_on_ros_2(machine, monkeypatch):
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from parapod.systems.hardware.buses.ros2.bus import Ros2Bus

    descriptions, poses = [], []
    monkeypatch.setattr(Ros2Bus, "describe", lambda bus, *look: descriptions.append(look))
    monkeypatch.setattr(Ros2Bus, "place", lambda bus, bodies, time: poses.append(bodies))
    monkeypatch.setattr(Ros2Bus, "is_watched", True)
    number = crc32(f"{os.getpid()} {time.time_ns()}".encode())
    said = served(machine, f"ros2://{1 + number % 100}#test_{number:08x}")
    for part in machine.parts:
        if any(port.part == part for port in machine.measured):
            assert f"publishes /test_{number:08x}/{part}/status: " in said
    takes = {line.split()[1]: line for line in said.splitlines() if line.startswith("  takes ")}
    for port in machine.inputs:
        line = takes[f"/test_{number:08x}/{port.part}/command:"]
        is_driven = any(other.twist for other in machine.inputs if other.part == port.part)
        assert line.endswith(", or geometry_msgs/msg/TwistStamped") == is_driven
    ((urdf, visuals),) = descriptions
    assert f'<robot name="{machine.name}"' in urdf
    if "is drawn once" in said:
        assert poses == []  # nobody publishes the estimates
    else:
        assert {*poses[0]} == {*visuals}
        assert all(f'<link name="{body}"' in urdf for body in poses[0])
        for position, turn in poses[0].values():
            assert np.isfinite(position).all()
            assert math.isclose(np.linalg.norm(turn), 1.0, rel_tol=1e-9)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (MissingExtra("visualization_msgs", "ros2", "not there"), "parapod[ros2]"),
        (ParapodError("no marker draws a HalfSpace"), "no marker draws a HalfSpace"),
    ],
)
def test_a_machine_that_cannot_be_drawn_is_served_and_says_so(monkeypatch, error, words):
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from parapod.systems.hardware.buses.ros2.bus import Ros2Bus

    def refuse(*_):
        raise error

    monkeypatch.setattr(Ros2Bus, "describe", refuse)
    number = crc32(f"{os.getpid()} {time.time_ns()}".encode())
    (machine,) = [one for one in MACHINES if one.name == "any_mechanism"]
    said = served(machine, f"ros2://{1 + number % 100}#test_{number:08x}")
    (line,) = [line for line in said.splitlines() if "is not drawn" in line]
    assert words in line


def test_nobody_computes_a_picture_that_nobody_looks_at(monkeypatch):
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from parapod.sims.output.drawn_bodies import DrawnBodies

    made = []
    poses = DrawnBodies.poses
    monkeypatch.setattr(DrawnBodies, "poses", lambda bodies: made.append(1) or poses(bodies))
    number = crc32(f"{os.getpid()} {time.time_ns()}".encode())
    (machine,) = [one for one in MACHINES if one.name == "any_mechanism"]
    served(machine, f"ros2://{1 + number % 100}#test_{number:08x}")
    assert len(made) == 1  # what Drake makes at the first


@pytest.mark.parametrize("error", [None, ParapodError("no pose")])
def test_no_tick_waits_for_a_picture_or_ends_with_it(monkeypatch, error):
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from parapod.systems.hardware.buses.ros2.bus import Ros2Bus

    threads = []

    def place(*_):
        threads.append(threading.current_thread())
        if error is not None:
            raise error

    monkeypatch.setattr(Ros2Bus, "is_watched", True)
    monkeypatch.setattr(Ros2Bus, "place", place)
    number = crc32(f"{os.getpid()} {time.time_ns()}".encode())
    (machine,) = [one for one in MACHINES if one.name == "any_mechanism"]
    said = served(machine, f"ros2://{1 + number % 100}#test_{number:08x}")
    assert threads
    assert threading.main_thread() not in threads
    assert ("is not drawn any more: no pose" in said) == (error is not None)


def test_a_machine_that_is_served_is_not_recorded(monkeypatch):
    loops = []

    def noted(*args, **options):
        loops.append(ClosedLoop(*args, **options))
        return loops[-1]

    monkeypatch.setattr("parapod.sims.real_machine.serve.ClosedLoop", noted)
    served(MACHINES[0], "lcm://memq://")
    assert [loop.logs for loop in loops] == [{}]  # it may be served for days


def test_a_log_of_a_machine_that_is_served_names_the_experiment_that_draws_it(tmp_path):
    served(MACHINES[0], "lcm://memq://", log=tmp_path / "served.mcap")
    assert read_log(tmp_path / "served.mcap").metadata["experiment"] == MACHINES[0].experiment


def test_a_machine_whose_scenario_names_a_controller_is_not_served():
    scenario = MACHINES[0].scenario()
    scenario.control.controller = "lcm://"
    with pytest.raises(ScenarioError, match=r"control\.controller must be empty"):
        serve(MACHINES[0], scenario, "lcm://", RunOptions())
