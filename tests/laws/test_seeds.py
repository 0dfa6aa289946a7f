"""Laws of the seed of every machine's scenario, and of those that are made of their base."""

import pytest

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.machine import MachineScenario, list_machines
from parapod.systems.core.errors import ScenarioError

MACHINES = list_machines()


@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.name)
@pytest.mark.parametrize("seed", [0, 2**31 - 1])
def test_every_seed_of_31_bits_begins_a_loop(machine, seed):
    scenario = machine.scenario(backend="kinematic", seed=seed)
    loop = ClosedLoop(machine, scenario, log=())
    assert scenario.seed == seed
    assert loop.CreateDefaultContext().get_time() == 0.0


@pytest.mark.parametrize(
    "schema",
    [MachineScenario, *(machine.scenario for machine in MACHINES)],
    ids=lambda schema: schema.__name__,
)
def test_seeds_have_31_bits(schema):
    assert schema(seed=2**31 - 1).seed == 2**31 - 1
    for seed in (-1, 2**31):
        with pytest.raises(ScenarioError, match="seed"):
            schema(seed=seed)
