from dataclasses import dataclass

import numpy as np
import pytest

from parapod.sims.output.logs import stored
from parapod.sims.output.logs.files import write_experiment_log
from parapod.sims.output.logs.stored import open_log
from parapod.systems.core.errors import OutputError
from parapod.systems.core.schema import Schema, choice, quantity

FORMATS = (".npz", ".csv", ".mcap")
COUNT = 50


@dataclass
class Swing(Schema):
    """A scenario."""

    backend: str = choice("exact", ("exact",))
    seed: int = quantity(3, 0, 9)


@pytest.fixture(params=FORMATS)
def path(request, tmp_path):
    """A log of fifty samples a second apart."""
    path = tmp_path / f"run{request.param}"
    random = np.random.default_rng(0)
    signals = {
        "legs.extension": (random.normal(size=(COUNT, 4)), "m"),
        "mass": (np.arange(COUNT), "kg"),
        "status.age": (random.normal(size=(COUNT, 1)), "s"),
    }
    write_experiment_log(path, "swing", Swing(), np.arange(COUNT), signals)
    return path


def test_pieces_are_the_log(path, monkeypatch):
    whole = open_log(path).read()
    monkeypatch.setattr(stored, "_PIECE", 7)
    log = open_log(path)
    names = ["status.age", "legs.extension"]
    pieces = list(log.pieces(names))
    assert len(pieces) == 8
    assert log.cut_at is None
    np.testing.assert_array_equal(np.concatenate([time for time, _ in pieces]), whole.time)
    for name in names:
        joined = np.concatenate([samples[name] for _, samples in pieces])
        np.testing.assert_array_equal(joined, whole.signals[name])
    assert all(set(samples) == set(names) for _, samples in pieces)
    assert [*log.shapes] == [*whole.signals]
    assert log.units == whole.metadata["units"]


def test_times_alone_can_be_read(path):
    times = np.concatenate([time for time, samples in open_log(path).pieces([]) if not samples])
    np.testing.assert_array_equal(times, np.arange(COUNT))


@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_a_log_that_is_cut_off_is_read_as_far_as_it_goes_or_refused(path, share):
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    if path.suffix == ".npz":
        with pytest.raises(OutputError, match=r"cannot read log .*: it is cut off or damaged$"):
            open_log(path)
        return
    log = open_log(path)
    read = log.read()
    assert 0 < len(read.time) < COUNT or share == 0.95
    np.testing.assert_array_equal(read.time, np.arange(len(read.time)))
    # Behind the last sample of an MCAP file comes what nobody needs to read it.
    assert log.cut_at == (read.time[-1] if len(read.time) < COUNT else None)
    assert all(len(each) == len(read.time) for each in read.signals.values())


def test_a_damaged_archive_is_refused_while_it_is_read(path):
    if path.suffix != ".npz":
        pytest.skip("it has no sums")
    content = bytearray(path.read_bytes())
    content[400] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(OutputError, match="cannot read log"):
        open_log(path).read()
