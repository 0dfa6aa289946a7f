"""Pictures of the machines, and the times at which they are drawn."""

from unittest.mock import Mock

import numpy as np
import pytest
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams import drawing
from parapod.diagrams.drawing import publish
from parapod.diagrams.machining_centre.view import SwitchColours
from parapod.diagrams.wiring import add
from parapod.sims.walking_chair.report import chapter
from parapod.systems.levelling_platform.sliders import PostureSliders
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.walking_chair.chair import chair_inverse, foot_corners
from parapod.systems.walking_chair.gait import Walk
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.masses import Passenger

CHAIR_GEOMETRY = ChairGeometry()


def test_meshcat_is_told_thirty_times_a_second():
    builder = DiagramBuilder()
    publish(builder, add(builder, SceneGraph()), Meshcat(), "drawn")
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(2.01)
    assert simulator.get_num_publishes() == 1 + 60


def test_closed_locks_and_open_clamps_are_coloured_and_no_others():
    scene = Mock(Meshcat)
    colours = SwitchColours(CentreGeometry(3), scene, "centre")
    context = colours.CreateDefaultContext()
    locked = np.arange(12) % 4 == 1  # joint 2 of each limb
    for name, values in (("locks_closed", locked), ("clamps_closed", (1.0, 0.0, 1.0))):
        colours.GetInputPort(name).FixValue(context, np.array(values, dtype=float))
    colours.ForcedPublish(context)
    seen = {path: is_seen for (path, _, is_seen, _), _ in scene.SetProperty.call_args_list}
    assert len(seen) == 15
    assert {path for path, is_seen in seen.items() if is_seen} == {
        *(f"centre/limb_{i}/ankle_2/locked_2" for i in (1, 2, 3)),
        "centre/limb_2/foot/let_go",
    }


def test_sliders_are_read_twenty_times_a_second():
    timing = PostureSliders(Meshcat()).GetUniquePeriodicDiscreteUpdateAttribute()
    assert (timing.period_sec(), timing.offset_sec()) == (0.05, 0.0)


@pytest.mark.parametrize("passenger", [Passenger(), Passenger(0.0)], ids=["with", "without"])
def test_a_picture_of_the_chair_shows_it_where_its_walk_is(monkeypatch, passenger):
    """Without a renderer: what would be seen is read from the scene."""
    seen = {}

    def take(scene_graph, root_context, views):
        scene = scene_graph.get_query_output_port().Eval(
            scene_graph.GetMyContextFromRoot(root_context)
        )
        inspector = scene.inspector()
        for frame in inspector.GetAllFrameIds():
            seen[inspector.GetName(frame)] = scene.GetPoseInWorld(frame)
        return list(views)

    monkeypatch.setattr(drawing, "add_renderer", lambda scene_graph: None)
    monkeypatch.setattr(drawing, "take", take)
    assert chapter._photograph(["from the side"], passenger) == ["from the side"]
    motion = Walk().motion(CHAIR_GEOMETRY, chapter._MID_SWING)
    body = motion.body.position
    np.testing.assert_allclose(seen["body::body"].translation(), body, atol=1e-12)
    place = seen["passenger::passenger"].translation()
    np.testing.assert_allclose(place, body + passenger.place, atol=1e-12)
    lengths = chair_inverse(
        CHAIR_GEOMETRY, body, np.eye(3), motion.feet.position, motion.references
    )
    corners = foot_corners(CHAIR_GEOMETRY, body, np.eye(3), lengths)
    told = corners[np.arange(4), np.asarray(motion.references) - 1]
    np.testing.assert_allclose(told, motion.feet.position, atol=1e-12)
    feet = [seen[f"leg_{i}::foot"].translation() for i in (1, 2, 3, 4)]
    np.testing.assert_allclose(feet, corners[:, 0], atol=1e-12)
    assert max(foot[2] for foot in feet) > 0.01  # one is on its way
