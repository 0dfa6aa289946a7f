"""The mechanisms' chapter: a machine of a model file, without a paper to compare with."""

from typing import Any

from parapod.diagrams.any_mechanism.design import MechanismDesign
from parapod.diagrams.drawing import View, photograph
from parapod.sims.output.rendered import rendered
from parapod.sims.report.chapter import Chapter, Part, Picture
from parapod.systems.mechanism.model import add_model

_VIEW = View((1.5, -1.9, 1.1), (0.0, 0.0, 0.25), angle=0.33, size=(1200, 1000))


def pictures() -> tuple[Picture, ...]:
    """The default model.

    Raises:
        RuntimeError: there is no OpenGL to render with.
    """
    return rendered(_take)


def _take() -> tuple[Picture, ...]:
    design = MechanismDesign()
    mechanism = design.built.mechanism
    pose = (0.0, 0.0, 0.5, 0.2, -0.1, 0.0)
    goal = [pose[part] if part in design.built.parts else float("nan") for part in range(6)]
    q = mechanism.inverse(design.built.frame, goal)

    def add_drawn(plant: Any, *others: Any) -> Any:
        add_model(plant, design.path)
        plant.Finalize()
        return plant

    (picture,) = photograph(
        [_VIEW], add_drawn, lambda plant, context: plant.SetPositions(context, q)
    )
    caption = "The default model, its platform rolled by 11 deg: 3 motors, 7 joints, 2 loops."
    return (Picture("A 3-RPS platform", caption, picture),)


_SHORT = "track.speed=1"

CHAPTER = Chapter(
    title="Mechanisms of model files",
    paper="",
    summary=(
        "A URDF, SDFormat or MJCF and a small YAML make a machine: its kinematics are found "
        "numerically, its loops are closed by constraints, and its frame is led in coordinates "
        "that its motors can set. Shown with a 3-RPS platform."
    ),
    parts=(
        Part(
            "mechanism-track",
            "Led along a way",
            "The frame goes along each of its coordinates, both ways, half as far as motors, "
            "limits and singular positions let it.",
            "mechanism-track",
            quick=(_SHORT, "backend=kinematic"),
            is_random=False,
        ),
        Part(
            "mechanism-workspace",
            "Poses that are reached",
            "A grid of poses is flooded from home, so that all of it is reached without taking "
            "the mechanism apart.",
            "mechanism-workspace",
            quick=("cells=10", "asked_percent=60"),
            is_random=False,
        ),
        Part(
            "mechanism-load",
            "Forces under a load",
            "Statics project the inverse dynamics of the open tree onto the motions that loops "
            "let; rigid bodies with constraints, which know nothing of that, have the same "
            "forces.",
            "mechanism-load",
            is_random=False,
        ),
    ),
    claims=(),
    pictures=pictures,
)
