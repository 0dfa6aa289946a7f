"""What a machine is doing, written into its scene."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform

_HEIGHT = 0.16  # of capital letters [m]
_PLACE = np.array([-1.25, 1.1, 1.75])  # lower left corner of the text [m]
_PATH = "/phase"


class PhaseLabel:
    """One word above the machine, readable from the front."""

    def __init__(self, meshcat: Meshcat):
        """Creates the label, without a word yet.

        Args:
            meshcat: the scene.
        """
        self._meshcat = meshcat
        self._drawn: set[str] = set()
        self._shown = ""

    def show(self, word: str, time: float) -> None:
        """Shows another word from this time on, in a recording too [s]."""
        if word not in self._drawn:
            self._drawn.add(word)
            begin, end = _outline(word)
            path = f"{_PATH}/{word}"
            self._meshcat.SetLineSegments(path, begin, end, 3.0, Rgba(0.10, 0.20, 0.35))
            self._meshcat.SetTransform(path, RigidTransform(_PLACE))
            self._meshcat.SetProperty(path, "visible", False, time_in_recording=0.0)
        for name, visible in ((self._shown, False), (word, True)):
            if name:
                self._meshcat.SetProperty(
                    f"{_PATH}/{name}", "visible", visible, time_in_recording=time
                )
        self._shown = word


def _outline(word: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Line segments (3, n) from and to, upright in the plane y = 0 [m]."""
    from matplotlib.textpath import TextPath

    polygons: Any = TextPath((0.0, 0.0), word, size=1.0).to_polygons(closed_only=False)
    begin = np.vstack([polygon[:-1] for polygon in polygons])
    end = np.vstack([polygon[1:] for polygon in polygons])
    # Capital letters of that font are 0.73 high.
    scale = _HEIGHT / 0.73
    flat = [scale * np.column_stack([p[:, 0], np.zeros(len(p)), p[:, 1]]).T for p in (begin, end)]
    return flat[0], flat[1]
