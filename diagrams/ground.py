"""The ground that all machines stand on."""

import logging

from pydrake.multibody.parsing import Parser
from pydrake.multibody.tree import ModelInstanceIndex


def add_ground(parser: Parser) -> ModelInstanceIndex:
    """Adds the body `ground`, a plane drawn as a ruled slab; it is to be welded somewhere.

    Args:
        parser: of the plant, which knows the models of `parapod.urdf`.
    """
    (slab,) = parser.AddModels(url="package://parapod/ground/ground.sdf")
    return slab


def _concerns_us(record: logging.LogRecord) -> bool:
    """False for Drake's warning that a half space does not touch deformable bodies: none here."""
    return "half spaces are not currently supported for deformable" not in record.getMessage()


logging.getLogger("drake").addFilter(_concerns_us)
