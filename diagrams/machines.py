"""The machines that there are."""

from typing import Any

from parapod.diagrams.levelling_platform.machine import LEVELLING_PLATFORM
from parapod.diagrams.machine import Machine
from parapod.diagrams.walking_chair.machine import WALKING_CHAIR
from parapod.systems.core.errors import ScenarioError

MACHINES: tuple[Machine[Any], ...] = (LEVELLING_PLATFORM, WALKING_CHAIR)


def machine_of(scenario: Any) -> Machine[Any]:
    """The machine of a scenario.

    Raises:
        ScenarioError: it is of none.
    """
    for machine in MACHINES:
        if machine.has(scenario):
            return machine
    known = ", ".join(machine.experiment for machine in MACHINES)
    raise ScenarioError(
        f"a {type(scenario).__name__} is not of a machine with devices; those of {known} are"
    )
