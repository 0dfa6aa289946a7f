import numpy as np
import pytest

from parapod.diagrams.chart import units_of
from parapod.diagrams.recording import Recording

TIME = np.array([0.0, 1.0])


@pytest.mark.parametrize(
    ("unit", "size", "each"),
    [
        ("V", 2, ["V", "V"]),
        ("rad, rad, m", 3, ["rad", "rad", "m"]),
        ("m, m/s", 4, ["m", "m", "m/s", "m/s"]),
        ("rad, m, and their rates", 4, ["rad", "m", "rad/s", "m/s"]),
        ("rad, m and rates", 4, ["rad", "m", "rad/s", "m/s"]),
        ("rad, rad/s, m/s^2", 3, ["rad", "rad/s", "m/s^2"]),
        # What the text leaves open is not guessed.
        ("m, rad, s", 9, ["m, rad, s"] * 9),
        ("m, m/s", 3, ["m, m/s"] * 3),
    ],
)
def test_units_of_elements(unit, size, each):
    assert units_of(unit, size) == each


def test_elements_of_different_units_are_drawn_apart_and_angles_in_degrees():
    samples = np.array([[0.0, 0.0, 0.4], [np.pi, 0.1, 0.5]])
    recording = Recording(TIME, {"posture": samples}, {"posture": "rad, rad, m"})
    angles, height = recording.plot("posture").axes
    assert (angles.get_ylabel(), height.get_ylabel()) == ("[deg]", "[m]")
    assert [line.get_ydata()[-1] for line in angles.lines] == pytest.approx([180.0, 18.0 / np.pi])
    assert height.lines[0].get_ydata().tolist() == [0.4, 0.5]
    assert [text.get_text() for text in angles.get_legend().get_texts()] == ["1", "2"]


def test_a_plot_shows_itself_without_a_backend_of_matplotlib():
    recording = Recording(TIME, {"a": TIME[:, None]}, {"a": "V"})
    assert recording.plot()._repr_png_().startswith(b"\x89PNG")
