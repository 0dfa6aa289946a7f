"""The bench's controller in one program and the emulated bench with a treadmill in another."""

import numpy as np
import pytest

for library in ("canopen", "can", "serial", "mcap"):
    pytest.importorskip(library)


@pytest.fixture
def bench(emulate_bench):
    """A bench where its walk begins."""
    machine = emulate_bench()
    yield machine
    machine.end()


@pytest.fixture
def walk(bench):
    return ("run", "bench-walk", "--backend", "hardware", *bench.options[1:])


def test_a_walk_on_emulated_sliders_slide_belt_and_cells(bench, walk):
    bench.run_well(*walk)
    assert bench.is_neutral
    _, belt, pose, braked = bench.logged("belt.velocity", "truth.pose", "hip.brake")
    assert belt.max() == pytest.approx(0.4, abs=0.01)
    assert belt.min() > -0.01
    height = pose[:, 1]
    assert np.ptp(height) == pytest.approx(0.02, abs=1e-3)
    assert (braked > 0.5).all(), "no leg is there that the slide could lift"


@pytest.mark.slow
def test_a_slider_that_falls_silent_ends_the_walk_and_all_drives_hold(bench, walk):
    bench.measure_legs()
    program = bench.parapod(*walk)
    runs = bench.until(lambda: bench.wires.get("belt.velocity")[0] > 0.3, 40.0)
    bench.misbehave("sliders", "unplugged")
    holds = bench.until(lambda: bench.is_neutral, 2.0)
    stood = bench.wires.get("sliders.position")
    said = program.communicate(timeout=600)[1]
    moved = np.abs(np.subtract(bench.wires.get("sliders.position"), stood)).max()
    bench.misbehave("sliders", "well")
    assert runs, said
    assert holds, said
    assert program.returncode == 2
    assert "EPOS2 on slcan" in said.splitlines()[-1]
    assert moved < 2e-3
