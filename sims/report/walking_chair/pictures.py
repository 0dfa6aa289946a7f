"""Pictures of the walking chair, where the paper shows drawings and photographs."""

from parapod.diagrams.photograph import View
from parapod.diagrams.walking_chair.photograph import photograph
from parapod.sims.report.chapter import Picture
from parapod.sims.report.rendered import rendered
from parapod.systems.walking_chair.gait import Walk
from parapod.systems.walking_chair.masses import Passenger

# From so far that lines parallel in space nearly stay so [m].
_FAR = 30.0
_MID_SWING = 7.5  # of legs 1 and 3 [s]


def pictures() -> tuple[Picture, ...]:
    """The chair at a step, and its side and top view.

    Raises:
        RuntimeError: there is no OpenGL to render with.
    """
    return rendered(_take)


def _take() -> tuple[Picture, ...]:
    whole = View((2.6, 2.9, 1.6), (0.0, 0.05, 0.86), angle=0.53, size=(1000, 1280))
    side = View((_FAR, 0.0, 0.9), (0.0, 0.05, 0.90), angle=0.068, size=(1000, 1280))
    front = View((0.0, _FAR, 0.9), (0.0, 0.0, 0.74), angle=0.055, size=(1000, 1280))
    at_step, from_side = photograph([whole, side], Walk(), _MID_SWING, Passenger())
    (from_front,) = photograph([front], Walk(), _MID_SWING, Passenger(0.0))
    return (
        Picture(
            "The chair",
            "Legs 1 and 3 swing while 2 and 4 carry chair and passenger (in the place of Figs. 2 "
            "and 18).",
            at_step,
        ),
        Picture("Side", "Side view at the same instant (Fig. 16b).", from_side),
        Picture("Front", "Without a passenger, from the front (Fig. 2).", from_front),
    )
