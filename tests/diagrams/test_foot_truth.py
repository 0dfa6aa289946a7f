"""Truth about the feet of the simulated bodies."""

from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.levelling_platform.model import add_platform
from parapod.diagrams.multibody import add_plant
from parapod.systems.levelling_platform.model import FootTruth

GROUND = (0.05, -0.03)


def contact(body_a, body_b, force):
    """Contact of two bodies with the force on the second."""
    return SimpleNamespace(
        bodyA_index=lambda: body_a, bodyB_index=lambda: body_b, contact_force=lambda: force
    )


@pytest.mark.parametrize("roller_is", ["first", "second"])
def test_the_force_on_a_roller_is_towards_it_whichever_body_of_the_contact_it_is(
    monkeypatch, roller_is
):
    builder = DiagramBuilder()
    plant, _ = add_plant(builder, 1e-3, "lagged")
    model = add_platform(plant, ground=GROUND)
    truth = FootTruth(model, GROUND)
    rollers = [body.index() for body in model.leg_bodies("roller")]
    slab = plant.world_body().index()
    normal = RollPitchYaw(*GROUND, 0.0).ToRotationMatrix().matrix()[:, 2]
    # On the roller of the third leg in two points, and the first; one between other bodies.
    pressed = [(rollers[2], 100.0), (rollers[2], 20.0), (rollers[0], 40.0)]
    infos = [contact(slab, model.base.index(), 7.0 * normal)]
    for body, newtons in pressed:
        pair = (body, slab) if roller_is == "first" else (slab, body)
        infos.append(contact(*pair, newtons * normal * (-1.0 if roller_is == "first" else 1.0)))
    results = SimpleNamespace(
        num_point_pair_contacts=lambda: len(infos), point_pair_contact_info=infos.__getitem__
    )
    monkeypatch.setattr(truth, "_contact", SimpleNamespace(Eval=lambda context: results))
    force = truth.GetOutputPort("contact_force").Eval(truth.CreateDefaultContext())
    np.testing.assert_allclose(force, (40.0, 0.0, 120.0, 0.0), atol=1e-12)
