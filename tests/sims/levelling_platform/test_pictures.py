"""Pictures of the levelling platform, and what happens where nothing can take them."""

import os
import subprocess
import sys

import numpy as np
import pytest

from parapod.diagrams.drawing import View
from parapod.sims.levelling_platform.report.chapter import CHAPTER


@pytest.fixture
def taken(finished_chapter):
    """Pictures of the quick report."""
    quick = finished_chapter(CHAPTER)
    if not quick.pictures:
        pytest.skip(quick.problem)
    return quick.pictures


def test_the_machine_is_in_the_middle_of_every_picture(taken):
    for picture in taken:
        height, width, channels = picture.pixels.shape
        assert channels == 3
        # The platform's orange is nowhere else.
        red, green, blue = (picture.pixels[..., i].astype(int) for i in range(3))
        rows, columns = np.nonzero((red - blue > 90) & (red - green > 50))
        assert rows.size > 1000, picture.title
        assert abs(columns.mean() / width - 0.5) < 0.15, picture.title
        assert 0.2 < rows.mean() / height < 0.8, picture.title


def test_nothing_of_the_machine_is_cut_off_at_the_sides(taken):
    whole = taken[0].pixels
    for edge in (whole[0], whole[:, 0], whole[:, -1]):
        assert (edge == 255).all()


def test_without_opengl_the_reason_is_said_and_the_process_lives():
    code = (
        "from parapod.sims.levelling_platform.report.chapter import pictures\n"
        "if __name__ == '__main__':\n"
        "    try:\n        pictures()\n"
        "    except RuntimeError as error:\n        print(error)\n"
    )
    environment = os.environ | {"__EGL_VENDOR_LIBRARY_DIRS": "/nonexistent"}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "EGL" in done.stdout


def test_the_camera_looks_at_its_target_upright():
    view = View((3.0, -4.0, 2.0), (0.0, 1.0, 0.5))
    X_WC = view.X_WC
    target = X_WC.inverse().multiply(np.array(view.target))
    distance = np.linalg.norm(np.subtract(view.target, view.camera))
    np.testing.assert_allclose(target, [0.0, 0.0, distance], atol=1e-12)
    above = X_WC.inverse().multiply(np.add(view.target, [0.0, 0.0, 0.1]))
    assert above[1] < 0.0  # y points down in the picture
    assert above[0] == pytest.approx(0.0)
