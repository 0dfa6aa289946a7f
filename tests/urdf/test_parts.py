"""Laws of every file of a model: what it names is there, it parses, and its bodies can be."""

import re

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from parapod.urdf import MODELS_DIR, configure_parser

PARTS = sorted((*MODELS_DIR.rglob("*.urdf"), *MODELS_DIR.rglob("*.sdf")))
FILES = sorted((*PARTS, *MODELS_DIR.rglob("*.dmd.yaml")))


def named(path):
    return str(path.relative_to(MODELS_DIR))


def test_files_of_every_folder_are_found():
    assert {path.parent.name for path in PARTS} >= {
        "levelling_platform",
        "machining_centre",
        "walking_chair",
    }


@pytest.mark.parametrize("path", FILES, ids=named)
def test_a_file_names_files_that_exist(path):
    names = re.findall(r"package://parapod/([^\s\"'<]+)", path.read_text())
    assert names or path in PARTS
    assert [name for name in names if not (MODELS_DIR / name).is_file()] == []


@pytest.mark.parametrize("path", PARTS, ids=named)
def test_a_part_parses_without_warnings_into_bodies_that_can_be(path):
    plant = MultibodyPlant(1e-3)
    parser = Parser(plant)
    configure_parser(parser)
    parser.SetStrictParsing()
    assert len(parser.AddModels(str(path))) == 1
    for i in range(1, plant.num_bodies()):
        body = plant.get_body(BodyIndex(i))
        inertia = body.default_spatial_inertia()
        assert body.default_mass() > 0.0, body.name()
        assert inertia.IsPhysicallyValid(), body.name()
        about_centre = inertia.Shift(inertia.get_com()).CalcRotationalInertia()
        principal = np.sort(about_centre.CalcPrincipalMomentsOfInertia())
        assert principal[0] > 0.0, body.name()
        assert principal[0] + principal[1] >= principal[2] * (1.0 - 1e-9), body.name()
