"""Laws of the seed of every machine's scenario."""

import pytest

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.machine import list_machines
from parapod.systems.core.errors import ScenarioError

each_machine = pytest.mark.parametrize("machine", list_machines(), ids=lambda m: m.name)


@each_machine
@pytest.mark.parametrize("seed", [0, 2**31 - 1])
def test_every_seed_of_31_bits_begins_a_loop(machine, seed):
    scenario = machine.scenario(backend="kinematic", seed=seed)
    loop = ClosedLoop(machine, scenario, log=())
    assert scenario.seed == seed
    assert loop.CreateDefaultContext().get_time() == 0.0


@each_machine
@pytest.mark.parametrize("seed", [-1, 2**31])
def test_a_seed_beyond_31_bits_is_refused(machine, seed):
    with pytest.raises(ScenarioError, match="seed"):
        machine.scenario(seed=seed)
