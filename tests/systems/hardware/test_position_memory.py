"""Positions of self-locking actuators, kept from one program to the next."""

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from datetime import UTC, datetime
from types import SimpleNamespace

import pytest

from parapod.systems.hardware.device import DeviceError
from parapod.systems.hardware.ni.card import NiDaq
from parapod.systems.hardware.ni.settings import NiDaqSettings
from parapod.systems.hardware.position_memory import PositionMemory

EXTENSION = (0.401, 0.402, 0.1 + 0.3, 1.21 / 3.0)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "extensions.json"


@pytest.fixture
def memory(path):
    return PositionMemory(path, 4, "extension")


def test_without_a_file_nothing_is_recalled(memory, path):
    assert memory.recall() is None
    assert not path.exists()


def test_what_is_saved_is_recalled_to_the_last_bit(memory, path):
    memory.save(EXTENSION)
    assert memory.recall() == EXTENSION
    assert PositionMemory(path, 4, "extension").recall() == EXTENSION


def test_the_file_is_json_that_people_can_read_and_nothing_else_is_left(memory, path):
    memory.save(EXTENSION)
    told = json.loads(path.read_text())
    assert told["extension_m"] == list(EXTENSION)
    assert abs(datetime.fromisoformat(told["saved"]).timestamp() - time.time()) < 60.0
    assert told["programs_since_measured"] == 1
    assert [file.name for file in path.parent.iterdir()] == ["extensions.json"]


@pytest.mark.parametrize(
    ("ago", "words"),
    [
        (0.0, "second"),
        (40.0, "40 seconds ago"),
        (3.0 * 3600.0, "3 hours ago"),
        (200.0, "3 minutes ago"),
        (4e6, "46 days"),
    ],
)
def test_it_tells_how_old_positions_are(memory, path, ago, words):
    memory.save(EXTENSION, "measured by hand")
    told = json.loads(path.read_text())
    told["saved"] = datetime.fromtimestamp(time.time() - ago, UTC).isoformat()
    path.write_text(json.dumps(told))
    assert memory.recall() == EXTENSION
    assert words in memory.provenance
    assert memory.provenance.endswith("by one program since they were measured by hand")


def test_it_counts_the_programs_since_positions_were_measured(path):
    for programs in (1, 2, 3):
        memory = PositionMemory(path, 4, "extension")
        assert (memory.recall() is None) == (programs == 1)
        memory.forget()
        memory.save(EXTENSION, "measured by hand" if programs == 1 else None)
    memory.recall()
    assert "counted by 3 programs since" in memory.provenance
    memory.save(EXTENSION, "measured by hand")
    assert "by one program" in memory.provenance


def test_it_tells_how_a_reference_was_found_however_many_programs_ago(path):
    for reference in ("homed, again within 0.05 mm", None, None):
        memory = PositionMemory(path, 4, "extension")
        memory.recall()
        memory.save(EXTENSION, reference)
    memory.recall()
    assert memory.provenance.endswith("3 programs since they were homed, again within 0.05 mm")


def test_a_file_from_before_says_that_it_does_not_know_how_old_it_is(memory, path):
    path.write_text(json.dumps({"extension_m": list(EXTENSION)}))
    assert memory.recall() == EXTENSION
    assert memory.provenance.startswith("extensions as of an unknown time, ")


def test_what_was_forgotten_is_refused_with_what_to_do(memory):
    memory.save(EXTENSION)
    memory.forget()
    with pytest.raises(DeviceError) as caught:
        memory.recall()
    text = str(caught.value)
    assert "\n" not in text
    assert "so the extensions are unknown" in text
    assert "delete the file" in text
    memory.save(EXTENSION)
    assert memory.recall() == EXTENSION


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "cannot be read"),
        ("\udcff\udcfe", "cannot be read"),
        ("{", "cannot be read"),
        ("[0.4, 0.4, 0.4, 0.4]", "cannot be read"),
        ('"extension_m"', "cannot be read"),
        ("{}", "cannot be read"),
        ('{"extension_m": [0.4, 0.4, 0.4, 0.4], "saved": "soon"}', "cannot be read"),
        ('{"extension_m": 0.4}', "must have 4 extensions"),
        ('{"extension_m": [0.4, 0.4, 0.4]}', "must have 4 extensions"),
        ('{"extension_m": [0.4, 0.4, 0.4, NaN]}', "must have 4 extensions"),
        ('{"extension_m": [0.4, 0.4, 0.4, Infinity]}', "must have 4 extensions"),
        ('{"extension_m": [0.4, 0.4, 0.4, "0.4"]}', "must have 4 extensions"),
        ('{"extension_m": [0.4, 0.4, 0.4, true]}', "must have 4 extensions"),
        ('{"extension_m": [0.4, 0.4, 0.4, null]}', "must have 4 extensions"),
    ],
)
def test_a_file_that_is_none_of_ours_is_refused(memory, path, text, words):
    path.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(DeviceError, match=words) as caught:
        memory.recall()
    assert str(path) in str(caught.value)


def test_a_folder_in_its_place_is_refused(memory, path):
    path.mkdir()
    with pytest.raises(DeviceError, match="cannot be read"):
        memory.recall()
    with pytest.raises(DeviceError, match="cannot be written"):
        memory.save(EXTENSION)


def test_a_folder_that_is_not_there_is_named(tmp_path):
    memory = PositionMemory(tmp_path / "none" / "x.json", 4, "extension")
    for act in (memory.forget, lambda: memory.save(EXTENSION)):
        with pytest.raises(DeviceError, match="cannot be written: No such file or directory"):
            act()


def test_a_write_that_fails_leaves_what_was_there(memory, path, monkeypatch):
    memory.save(EXTENSION)

    def fail(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(DeviceError, match="cannot be written: No space left"):
        memory.save((0.0,) * 4)
    assert memory.recall() == EXTENSION


def test_a_program_that_is_killed_leaves_the_old_or_the_new_extensions(path):
    code = """if True:
        import itertools, sys
        from pathlib import Path
        from parapod.systems.hardware.position_memory import PositionMemory
        memory = PositionMemory(Path(sys.argv[1]), 4, "extension")
        for k in itertools.count():
            memory.save([float(k)] * 4)
            if k == 20:
                print(flush=True)
    """
    command = [sys.executable, "-c", code, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as program:
        program.stdout.readline()
        program.send_signal(signal.SIGKILL)
    found = PositionMemory(path, 4, "extension").recall()
    assert len(set(found)) == 1
    assert found[0] >= 20.0


# The card that keeps it


class Tasks:
    """Counters, inputs and outputs of a card whose encoders turn when a test says so."""

    watchdog = SimpleNamespace(had_expired=False, is_armed=False, reset=lambda share: None)

    def __init__(self, settings, name):
        self.counts, self.relay, self.time = [0] * 4, None, 0.0

    def begin(self):
        self.time += 0.01

    def opening(self, seconds):
        return nullcontext()

    def close(self):
        pass

    def read_counters(self):
        return [(count % 2**32, self.time) for count in self.counts]

    def read_inputs(self):
        return (*(0.0,) * 12, 1.0)

    def write_outputs(self, values):
        pass

    def write_relay(self, is_on):
        self.relay = is_on


@pytest.fixture
def card(path, monkeypatch):
    """card(): a new one at the same file, as a new program has it."""
    monkeypatch.setattr("parapod.systems.hardware.ni.card.NiTasks", Tasks)
    settings = NiDaqSettings(
        extension_at_start_mm=[410.0] * 4, extension_file=str(path), watchdog_ms=0.0
    )
    return lambda: NiDaq(settings)


def extension(card):
    return card.read()["extension"]


def turn(card, counts):
    card._tasks.counts = counts


def test_reading_without_power_changes_nothing_in_the_file(card, path):
    PositionMemory(path, 4, "extension").save(EXTENSION)
    before = path.read_bytes()
    with card() as ours:
        assert extension(ours) == pytest.approx(EXTENSION)
        ours.deactivate()
    assert path.read_bytes() == before


def test_what_still_moves_without_power_is_waited_for(card):
    with card() as ours:
        ours.activate()
        left = iter([30, 20, 10, 3, 1])
        read = ours.read

        def coasting():
            turn(ours, [100 - next(left, 0)] * 4)
            return read()

        ours.read = coasting
        ours.deactivate()
    with card() as next_one:
        assert extension(next_one) == pytest.approx((0.411,) * 4)


def test_an_encoder_that_is_never_quiet_does_not_keep_a_program_from_ending(card):
    with card() as ours:
        ours.activate()
        counts = itertools.cycle((100, 101))
        read = ours.read

        def restless():
            turn(ours, [next(counts)] * 4)
            return read()

        ours.read = restless
        ours.deactivate()
    with card() as next_one:
        assert extension(next_one) == pytest.approx((0.411,) * 4, abs=1.1e-5)


def test_deactivating_twice_saves_once(card, path):
    with card() as ours:
        ours.activate()
        ours.deactivate()
        saved = path.read_bytes()
        turn(ours, [500] * 4)
        ours.deactivate()
    assert path.read_bytes() == saved


def test_a_file_that_cannot_be_written_keeps_the_drives_without_power(card, path, monkeypatch):
    def fail(descriptor):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(os, "fsync", fail)
    with card() as ours:
        with pytest.raises(DeviceError, match="cannot be written: Read-only"):
            ours.activate()
        assert ours._tasks.relay is False


def test_while_a_reference_is_looked_for_the_file_knows_nothing_until_it_is_told(card, path):
    PositionMemory(path, 4, "extension").save(EXTENSION)
    with card() as ours:
        ours.deactivate()
    homing = card()
    homing.seek_reference()
    with homing:
        assert extension(homing) != pytest.approx(EXTENSION)  # the file is not believed
        homing.activate()
        homing.deactivate()
        with pytest.raises(DeviceError, match="extensions are unknown"):
            PositionMemory(path, 4, "extension").recall()
        homing.set_reference(EXTENSION)
        turn(homing, [100] * 4)
        homing.activate()
        homing.deactivate()
        assert json.loads(path.read_text()) == {"extension_m": None}
        homing.remember("homed")
    with card() as next_one:
        assert extension(next_one) == pytest.approx([x + 1e-3 for x in EXTENSION])
        assert "since they were homed" in next_one.remarks[-1]


def test_a_card_without_a_file_has_nothing_to_keep_a_reference(monkeypatch):
    card = NiDaq(NiDaqSettings(extension_at_start_mm=[410.0] * 4, extension_file=""))
    with pytest.raises(DeviceError, match="has no extension_file to keep a reference"):
        card.seek_reference()
