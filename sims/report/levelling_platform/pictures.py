"""Pictures of the levelling platform, where the paper shows drawings and photographs."""

import math

from parapod.diagrams.levelling_platform.photograph import photograph
from parapod.diagrams.photograph import View
from parapod.sims.report.chapter import Picture
from parapod.sims.report.rendered import rendered

_HEIGHT = 0.477  # in the middle of what the stroke allows [m]
_GROUND = (math.radians(2.0), math.radians(3.0))
_UPRIGHT, _LEANING = (0.0, 0.0), (0.0, math.radians(35.0))
# From so far that lines parallel in space nearly stay so [m].
_FAR = 30.0


def pictures() -> tuple[Picture, ...]:
    """The whole machine at work, and its front and top view.

    Raises:
        RuntimeError: there is no OpenGL to render with.
    """
    return rendered(_take)


def _take() -> tuple[Picture, ...]:
    whole = View((2.9, -5.9, 1.9), (0.08, 0.0, 0.96), angle=0.50, size=(1280, 1080))
    front = View((0.0, -_FAR, 0.6), (0.0, 0.0, 0.40), angle=0.033, size=(1280, 640))
    top = View(
        (0.0, 0.0, _FAR), (0.0, 0.0, 0.3), angle=0.052, size=(1280, 1000), up=(0.0, 1.0, 0.0)
    )
    level = [0.0, 0.0, _HEIGHT]
    (at_work,) = photograph([whole], level, _GROUND, _LEANING)
    from_front, from_top = photograph([front, top], level, arm=_UPRIGHT)
    return (
        Picture(
            "The platform",
            "Level on ground that rolls by 2 and pitches by 3 deg, its arm leaning by 35 deg "
            "(in the place of Figs. 3, 12a and 19).",
            at_work,
        ),
        Picture("Front", "Front view (Fig. 1a).", from_front),
        Picture("Top", "Top view (Fig. 1b).", from_top),
    )
