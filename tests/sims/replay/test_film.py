"""Videos of logs, by Drake's renderer."""

import av
import numpy as np
import pytest
from PIL import Image
from pydrake.geometry import Box, MeshcatParams, Rgba, SceneGraph, Sphere
from pydrake.math import RigidTransform
from rich.console import Console

from parapod.diagrams.drawing import View
from parapod.diagrams.machine import find_machine
from parapod.sims.cli.main import main
from parapod.sims.lab.discovery import find_experiment
from parapod.sims.lab.stage import Stage
from parapod.sims.output.rendered import rendered
from parapod.sims.replay import film
from parapod.systems.core.errors import ParapodError
from parapod.systems.walking_chair.gait import Walk, starting_lengths
from parapod.systems.walking_chair.geometry import ChairGeometry

CHAIR_GEOMETRY = ChairGeometry()

LIFT = RigidTransform(np.array((0.0, 0.0, 0.5)))
VIEW = View((3.0, 0.0, 0.5), (0.0, 0.0, 0.5), size=(160, 120))


def stage_with(*, hidden=()):
    """A red ball 0.5 m above a grey floor, under a path that is lifted."""
    stage = Stage(MeshcatParams())
    stage.SetObject("/floor", Box(2.0, 2.0, 0.02), Rgba(0.5, 0.5, 0.5))
    stage.SetObject("lifted/ball", Sphere(0.2), Rgba(1.0, 0.0, 0.0))
    stage.SetTransform("lifted", LIFT)
    corners = np.array([(0.0, 0.5, 0.0), (0.0, 1.0, 0.0), (0.0, 0.5, 0.5)]).T
    stage.SetTriangleMesh("flag", corners, np.array([[0], [1], [2]]), Rgba(0.0, 0.0, 1.0))
    for path in hidden:
        stage.SetProperty(path, "visible", False)
    return stage


def _photograph(hidden):
    nothing = SceneGraph()
    picture = film.Film(stage_with(hidden=hidden), nothing, "measured")
    return picture.picture(nothing.CreateDefaultContext(), VIEW).astype(int)


def _pictures():
    return _photograph(()), _photograph(("lifted",))


@pytest.fixture
def log(work):
    """A log of a chair that stands, and leans by its legs' lengths, for 4 s."""
    scenario = find_machine("walking_chair").scenario(backend="kinematic")
    lengths = starting_lengths(CHAIR_GEOMETRY, Walk()).ravel()
    time = 0.05 * np.arange(81)
    signals = {"legs.position": (lengths + 1e-3 * np.sin(time)[:, None], "m")}
    path = work / "chair.npz"
    find_experiment("chair-walk").write_log(path, scenario, time, signals)
    return path


@pytest.fixture(scope="module")
def pictures():
    try:
        return rendered(_pictures)
    except RuntimeError as error:
        pytest.skip(str(error))


def middle_of(mask):
    """Mean row and column of the pixels in a mask."""
    return np.argwhere(mask).mean(axis=0)


def test_what_is_on_the_stage_is_seen_where_it_is(pictures):
    picture, _ = pictures
    red, _, blue = np.moveaxis(picture, -1, 0)
    ball = red > blue + 30
    # Where the camera looks, 0.2 m of 2 * 3 m * tan(0.3).
    assert middle_of(ball) == pytest.approx((59.5, 79.5), abs=1.0)
    radius = 0.2 / (2.0 * 3.0 * np.tan(0.3)) * 120
    assert ball.sum() == pytest.approx(np.pi * radius**2, rel=0.1)
    flag = blue > red + 60
    assert middle_of(flag)[1] > 100  # y to the right, seen along -x
    assert flag.sum() > 100


def test_what_is_hidden_is_not_seen(pictures):
    _, picture = pictures
    red, _, blue = np.moveaxis(picture, -1, 0)
    assert not (red > blue + 30).any()


def test_a_deleted_object_is_forgotten_with_what_is_below_it():
    stage = stage_with()
    stage.Delete("lifted")
    assert set(stage.props) == {"/floor", "/drake/flag"}


def test_every_instant_of_a_video_shows_the_newest_picture():
    pictures = [(time, {}) for time in (1.0, 1.1, 1.5)]
    assert film._at_rate(pictures, 10.0) == [0, 1, 1, 1, 1, 2]


@pytest.mark.parametrize("suffix", film.FORMATS)
def test_a_video_of_a_log_takes_as_long_as_the_log(log, work, pictures, suffix):
    path = work / f"walk{suffix}"
    assert main(["replay", str(log), "--video", str(path), "--between", "0", "2"]) == 0
    if suffix == ".gif":
        with Image.open(path) as gif:
            assert gif.n_frames * gif.info["duration"] == pytest.approx(2000, abs=100)
        return
    with av.open(str(path)) as video:
        frames = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
    assert len(frames) == 2 * 25 + 1
    assert np.ptp(frames[0].astype(int), axis=(0, 1)).min() > 100  # the machine and the sky


def test_a_log_without_a_drawing_is_refused_and_leaves_no_file(log, work, pictures):
    bare, scenario = work / "bare.npz", find_machine("walking_chair").scenario()
    signals = {"legs.current": (np.zeros((3, 12)), "A")}
    find_experiment("chair-walk").write_log(bare, scenario, np.arange(3.0), signals)
    with pytest.raises(ParapodError, match=r"no video of .*bare\.npz.*: the log has no legs"):
        film.write_video(bare, work / "bare.gif", Console())
    assert not (work / "bare.gif").exists()
