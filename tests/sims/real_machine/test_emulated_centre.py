"""The tripod's controller in one program and the emulated tripod in another."""

import numpy as np
import pytest

for library in ("canopen", "can", "serial", "mcap"):
    pytest.importorskip(library)


@pytest.fixture
def centre(emulate_centre):
    """A tripod where its walk begins."""
    machine = emulate_centre()
    yield machine
    machine.end()


@pytest.fixture
def walk(centre):
    return ("run", "centre-walk", "--backend", "hardware", *centre.options[1:])


def test_a_tripod_walks_on_emulated_devices_one_loose_foot_at_a_time(centre, walk):
    centre.run_well(*walk)
    assert centre.is_neutral
    _, clamps, feet, locks = centre.logged("clamps.closed", "truth.feet", "locks.closed")
    loose = (clamps < 0.5).sum(axis=1)
    assert loose.max() == 1
    assert all((clamps[:, limb] < 0.5).any() for limb in range(3))
    # While a foot is loose all locks of its limb are closed, and two more.
    locked = locks.reshape(-1, 3, 4) > 0.5
    for limb in range(3):
        during = locked[clamps[:, limb] < 0.5]
        assert during[:, limb].all()
        assert (during.sum(axis=(1, 2)) == 6).all()
    gone = 1e3 * (feet[-1] - feet[0]).reshape(3, 6)[:, 0]
    assert gone == pytest.approx(20.0, abs=0.5)


@pytest.mark.slow  # the sequence alone every day: tests/systems/machining_centre
def test_a_clamp_that_is_lost_while_a_limb_swings_stops_everything_where_it_stands(centre, walk):
    centre.measure_legs()
    program = centre.parapod(*walk)
    is_swinging = centre.until(lambda: min(centre.wires.get("clamps.command")) < 0.5, 40.0)
    begun = centre.wires.get("legs.position")
    moves = centre.until(
        lambda: np.abs(np.subtract(centre.wires.get("legs.position"), begun)).max() > 1e-3, 10.0
    )
    centre.misbehave("switches", "open")
    stops = centre.until(lambda: centre.wires.get("legs.brake")[0] > 0.5, 2.0)
    stood = centre.wires.get("legs.position")
    said = program.communicate(timeout=600)[1]
    moved = np.abs(np.subtract(centre.wires.get("legs.position"), stood)).max()
    centre.misbehave("switches", "well")
    assert is_swinging, said
    assert moves, said
    assert stops, said
    assert program.returncode == 2
    assert "the clamp of limb" in said.splitlines()[-1]
    assert "in swing; everything stands where it was" in said.splitlines()[-1]
    assert moved < 2e-3  # what they need to stop
    assert centre.is_neutral
