"""A mechanism posed by motors, by a frame, by sliders and by the mouse."""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.geometry import Meshcat

from parapod.sims.cli.main import main
from parapod.sims.lab.panel import Panel
from parapod.sims.lab.poser import HOME, PosePage, Poser
from parapod.systems.mechanism.model import add_model

EXAMPLES = Path(__file__).parents[3] / "examples" / "mechanisms"
HEXAPOD, DELTA = EXAMPLES / "hexapod" / "hexapod.urdf", EXAMPLES / "delta" / "delta.xml"


def poser_of(path: Path, meshcat: Meshcat | None = None, frame: str = "platform") -> Poser:
    return Poser(lambda plant: add_model(plant, path), frame, meshcat)


@pytest.fixture(scope="module")
def meshcat() -> Meshcat:
    return Meshcat()


@pytest.fixture
def page(meshcat: Meshcat) -> Iterator[tuple[Poser, Panel, PosePage]]:
    poser = poser_of(HEXAPOD, meshcat)
    panel = Panel(meshcat, "pose")
    yield poser, panel, PosePage(poser, panel)
    panel.close()
    meshcat.Delete()


def is_closed(poser: Poser) -> bool:
    return bool(np.abs(poser.mechanism.residual(poser.q)).max() < 1e-9)


def test_the_platform_is_the_frame_that_is_moved_unless_one_is_named():
    assert poser_of(HEXAPOD, frame="").frame == "platform"
    assert poser_of(DELTA, frame="").frame == "platform"
    assert poser_of(DELTA, frame="arm_1").parts == poser_of(DELTA, frame="arm_1").parts


def test_parts_of_a_pose_that_are_not_named_stay():
    poser = poser_of(HEXAPOD)
    poser.move_frame({2: 0.47, 3: 0.1})
    np.testing.assert_allclose(poser.pose, (0.0, 0.0, 0.47, 0.1, 0.0, 0.0), atol=1e-9)
    delta = poser_of(DELTA)
    assert delta.parts == (0, 1, 2)
    delta.move_frame({0: 0.05})
    np.testing.assert_allclose(delta.pose[:2], (0.05, 0.0), atol=1e-9)
    assert is_closed(delta)


def test_a_move_that_cannot_be_made_leaves_the_pose_and_a_remark():
    poser = poser_of(DELTA)
    before = poser.q.copy()
    poser.move_frame({2: -3.0})
    assert "platform cannot get there" in poser.remark
    np.testing.assert_array_equal(poser.q, before)
    assert poser.readout().is_alarming
    poser.move_frame({2: -0.3})
    assert not poser.remark


def test_limits_and_singular_positions_are_told():
    poser = poser_of(HEXAPOD)
    assert not poser.readout().is_alarming
    poser.move_frame({2: 0.6})
    assert "leg_1 is beyond its limits" in poser.readout().remarks


def test_sliders_move_motors_and_all_others_follow(page):
    poser, panel, look = page
    panel.SetSliderValue("leg_1 [mm]", 30.0)
    look.look()
    assert poser.motors[0] == pytest.approx(0.030)
    assert is_closed(poser)
    roll = panel.GetSliderValue("platform: roll [deg]")
    assert roll == pytest.approx(np.degrees(poser.pose[3]), abs=0.01)
    assert roll != 0.0
    panel.SetSliderValue("platform: z [mm]", 470.0)
    look.look()
    assert poser.pose[2] == pytest.approx(0.47)
    legs = [panel.GetSliderValue(f"leg_{i} [mm]") for i in range(1, 7)]
    np.testing.assert_allclose(legs, 1e3 * poser.motors, atol=0.01)
    panel._buttons[HOME] += 1
    look.look()
    np.testing.assert_allclose(poser.q, poser.mechanism.home)


def test_a_slider_that_asks_for_too_much_returns(page):
    poser, panel, look = page
    panel.SetSliderValue("platform: z [mm]", 0.0)
    look.look()
    if poser.remark:
        assert panel.GetSliderValue("platform: z [mm]") == pytest.approx(1e3 * poser.pose[2])
    assert is_closed(poser)


def dragged(path: str, anchor: Any, target: Any) -> bytes:
    """The message that a browser sends while the mouse drags a body, as MessagePack."""

    def text(word: str) -> bytes:
        return bytes([0xD9, len(word)]) + word.encode()

    def numbers(values: Any) -> bytes:
        return bytes([0x90 + len(values)]) + b"".join(
            b"\xcb" + struct.pack(">d", value) for value in values
        )

    return (
        b"\x84"
        + (text("type") + text("mouse_drag") + text("name") + text(path))
        + (text("drag_anchor") + numbers(anchor) + text("drag_target") + numbers(target))
    )


def test_the_mouse_drags_the_platform_and_loops_stay_closed(page, meshcat):
    poser, panel, look = page
    place = poser.pose[:3].copy()
    goal = place + np.array((0.02, 0.03, 0.04))
    path = "/drake/illustration/hexapod/platform"
    for _ in range(40):
        meshcat._InjectWebsocketMessage(dragged(path, poser.pose[:3], goal))
        look.look()
        assert is_closed(poser)
    np.testing.assert_allclose(poser.pose[:3], goal, atol=2e-3)
    legs = [panel.GetSliderValue(f"leg_{i} [mm]") for i in range(1, 7)]
    np.testing.assert_allclose(legs, 1e3 * poser.motors, atol=0.01)
    meshcat._InjectWebsocketMessage(dragged("", (), ()))
    before = poser.q.copy()
    look.look()
    np.testing.assert_array_equal(poser.q, before)


def test_the_mouse_cannot_pull_a_leg_beyond_its_limits():
    poser = poser_of(HEXAPOD)
    for _ in range(60):
        poser.pull("platform", (0.0, 0.0, 0.0), (0.0, 0.0, 0.1))
    assert poser.mechanism.beyond_limits(poser.q) == {}
    assert poser.motors.max() == pytest.approx(0.12, abs=0.02)


def test_the_command_tells_and_writes_what_a_mechanism_does(tmp_path, capsys):
    out = tmp_path / "pose.json"
    assert main(["pose", str(HEXAPOD), "--set", "leg_1=10mm", "--json", str(out)]) == 0
    text = capsys.readouterr().out
    assert "hexapod.urdf: 6 freedoms, 6 motors, 13 joints, 5 loops with 15 equations" in text
    assert "leg_1     10.000 mm  of -120..120, holds" in text
    numbers = json.loads(out.read_text())
    assert numbers["motors"]["leg_1"]["position"] == pytest.approx(0.01)
    # All legs together carry platform and legs.
    assert numbers["freedoms"] == 6


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--set", "leg_1"], "--set 'leg_1' is not NAME=VALUE"),
        (["--set", "leg_7=1mm"], "--set: 'leg_7' is not one of leg_1, leg_2"),
        (["--at", "w=1"], "--at: 'w' is not one of x, y, z, roll, pitch, yaw"),
        (["--set", "leg_1=1mm", "--at", "z=1"], "--set and --at cannot be combined"),
        (["--frame", "table"], "has no frame 'table'"),
        (["--motors", "leg_?", "hip_1"], "the universal joint hip_1 cannot have a motor"),
        (["--loops", "none.yaml"], "none.yaml"),
    ],
)
def test_mistakes_are_refused_in_a_line(capsys, words, line):
    assert main(["pose", str(HEXAPOD), *words]) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
