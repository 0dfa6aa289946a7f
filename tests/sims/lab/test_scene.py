import html
import re
from pathlib import Path

import pytest
from pydrake.geometry import Box, Meshcat, Rgba
from pydrake.math import RigidTransform

import parapod
from parapod.diagrams.machine import find_machine
from parapod.sims.lab.scene import Scene
from parapod.sims.output.scene_page import scene_page

_FRAMES = 100


@pytest.fixture(scope="module")
def recorded():
    """A scene with a box that moved while it was recorded, and one that did not."""
    meshcat = parapod.viewer(parapod.scenario("level", backend="kinematic"))
    meshcat.SetObject("/box", Box(1.0, 1.0, 1.0), Rgba(1.0, 0.0, 0.0))
    still = Scene.from_meshcat(meshcat)
    meshcat.StartRecording()
    for frame in range(_FRAMES):
        meshcat.SetTransform("/box", RigidTransform([0.01 * frame, 0.0, 0.0]), frame / 32.0)
    return still, Scene.from_meshcat(meshcat, height=300)


def test_a_recording_that_was_begun_is_in_the_scene(recorded):
    still, moving = recorded
    assert len(moving.html) - len(still.html) > 7 * 8 * _FRAMES  # place and quaternion of each


def test_a_scene_stands_in_a_notebook_as_a_page_of_its_own(recorded):
    shown = recorded[1]._repr_html_()
    (page,) = re.findall('srcdoc="([^"]*)"', shown)
    assert html.unescape(page) == scene_page(recorded[1].html)
    assert 'height="300"' in shown


def test_a_scene_is_written_under_a_title(recorded, tmp_path):
    recorded[1].write(tmp_path / "box.html", "A box")
    assert "<title>A box - parapod</title>" in (tmp_path / "box.html").read_text()


def test_an_experiment_without_a_machine_has_no_viewer():
    with pytest.raises(parapod.ParapodError, match="'chair-gait' has no scene"):
        parapod.viewer(parapod.scenario("chair-gait"))


def test_former_names_warn_and_do_the_same():
    meshcat = Meshcat()
    with pytest.warns(DeprecationWarning, match="Scene.of is now Scene.from_meshcat"):
        assert Scene.of(meshcat).height == Scene.from_meshcat(meshcat).height
    machine = find_machine("levelling_platform")
    scenario = machine.scenario()
    with pytest.warns(DeprecationWarning, match="Machine.of is now Machine.for_scenario"):
        assert machine.of(scenario).ports == machine.for_scenario(scenario).ports


def test_the_lines_of_the_readme_show_the_platform_getting_level():
    readme = (Path(__file__).parents[3] / "README.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)
    lines = [line for line in code.splitlines() if line]
    assert len(lines) == 6
    names = {}
    # A beginning on the kinematic backend is enough to see it move.
    brief = code.replace("12.0", "5.0").replace('"level",', '"level", "backend=kinematic",')
    exec(brief.replace("parapod.Scene", "scene = parapod.Scene"), names)
    still = Scene.from_meshcat(parapod.viewer(names["scenario"]))
    assert len(names["scene"].html) - len(still.html) > 10_000
