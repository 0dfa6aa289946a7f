from itertools import pairwise

import numpy as np
import pytest

from parapod.diagrams.recording import Recording, spans
from parapod.systems.core.errors import ParapodError

TIME = np.array([0.0, 1.0])


def test_elements_of_different_units_are_drawn_apart_and_angles_in_degrees():
    samples = np.array([[0.0, 0.0, 0.4], [np.pi, 0.1, 0.5]])
    recording = Recording(TIME, {"posture": samples}, {"posture": "rad, rad, m"})
    angles, height = recording.plot("posture").axes
    assert (angles.get_ylabel(), height.get_ylabel()) == ("posture [deg]", "posture [mm]")
    assert [line.get_ydata()[-1] for line in angles.lines] == pytest.approx([180.0, 18.0 / np.pi])
    assert height.lines[0].get_ydata().tolist() == [400.0, 500.0]
    assert [text.get_text() for text in angles.get_legend().get_texts()] == ["posture[0]", "[1]"]


def test_a_plot_shows_itself_without_a_backend_of_matplotlib():
    recording = Recording(TIME, {"a": TIME[:, None]}, {"a": "V"})
    assert recording.plot()._repr_png_().startswith(b"\x89PNG")


def test_positions_and_rates_of_one_signal_are_drawn_apart():
    samples = np.arange(12.0).reshape(2, 6)
    recording = Recording(TIME, {"lengths": samples}, {"lengths": "m, m/s"})
    lengths, rates = recording.plot().axes
    assert (lengths.get_ylabel(), rates.get_ylabel()) == ("lengths [mm]", "lengths [mm/s]")
    for axes, first in ((lengths, 0), (rates, 3)):
        drawn = [line.get_ydata().tolist() for line in axes.lines]
        assert drawn == [(1e3 * samples[:, first + i]).tolist() for i in range(3)]


def test_signals_share_a_plot_and_elements_are_chosen():
    signals = {"a": np.ones((2, 2)), "b": np.zeros((2, 1))}
    recording = Recording(TIME, signals, {"a": "V", "b": "V"})
    (axes,) = recording.plot("a[1]+b").axes
    assert [line.get_label() for line in axes.lines] == ["a[1]", "b"]
    with pytest.raises(ParapodError, match=r"'a' has elements 0 to 1, not '\[2\]'"):
        recording.plot("a[2]")
    with pytest.raises(ParapodError, match="no signal 'c' in the recording"):
        recording.plot("c")


@pytest.mark.parametrize("flags", ["", "0", "1", "0110", "1011", "111", "01010"])
def test_spans_are_as_long_as_can_be_and_hold_all_samples_whose_flags_are_up(flags):
    up = [flag == "1" for flag in flags]
    found = spans(up)
    assert [k for begin, end in found for k in range(begin, end)] == np.flatnonzero(up).tolist()
    assert all(end < begin for (_, end), (begin, _) in pairwise(found))
