"""The walking chair's controller in one program and the emulated chair in another."""

import json
import os
import re
import signal
import sys
import threading
import time
from typing import NamedTuple

import numpy as np
import pytest

from parapod.sims.cli.main import main
from parapod.sims.lab.files import Log
from parapod.sims.lab.mcap import read_mcap

for library in ("canopen", "can", "serial", "mcap"):
    pytest.importorskip(library)

# Where programs may not have a priority, others delay heartbeats by more than a drive bears.
PATIENT = "hardware.drivers.0.heartbeat_timeout_ms=500"
LIFT = 6.0  # [mm]
# Share of the commands that are to be made of measurements younger than a period [-].
IN_TIME = 0.95
# Lifts the body and lowers it again, with a small step of each foot in between.
STEP = (
    *("run", "chair-walk", "--backend", "hardware", "--set", "gait.way=forward"),
    *(f"gait.lift_mm={LIFT:g}", "gait.step_mm=10", "gait.swing_height_mm=2"),
    *("gait.phase_duration=1", "begin=0.5", "end=0.5"),
)
# Drives all legs out and in again until it is killed, with the default timeouts.
DRIVING = """
import math, sys, time
from parapod.diagrams.hardware_parts import make_parts
from parapod.diagrams.walking_chair.machine import WALKING_CHAIR as CHAIR

parts = make_parts(CHAIR.scenario().hardware.drivers, CHAIR.inputs, CHAIR.measured, 0.01)
(legs,) = parts.threads["legs"]
with parts.active():
    print("driving", flush=True)
    began = time.monotonic()
    while True:
        now = time.monotonic()
        legs.post({"velocity_command": [0.02] * 12, "brake": [0.0]}, now)
        legs.taken()
        time.sleep(0.01)
"""


@pytest.fixture(scope="module")
def chair(emulate_chair):
    return emulate_chair()


@pytest.fixture
def here(chair, monkeypatch):
    """The chair, for a controller in this process: neutral, well and referenced."""
    monkeypatch.setenv("PARAPOD_EMULATOR", chair.environment["PARAPOD_EMULATOR"])
    assert chair.is_neutral
    yield chair
    chair.misbehave("legs", "well")
    chair.measure_legs()


def share_in_time(said):
    """Of the commands: those made of measurements that were younger than a period."""
    (line,) = [line for line in said.splitlines() if line.startswith("EPOS2")]
    late, of = map(int, re.search(r"(\d+) of (\d+) above one period", line).groups())
    return 1.0 - late / of


class Stepped(NamedTuple):
    """A step by a controller in another process."""

    share: float
    log: Log
    metrics: dict


@pytest.fixture(scope="module")
def stepped(chair):
    """The least disturbed of a few steps."""
    best = None
    for k in range(4):
        log, metrics = chair.directory / f"{k}.mcap", chair.directory / f"{k}.json"
        program = chair.parapod(*STEP, PATIENT, "--log", log, "--json", metrics)
        _, said = program.communicate(timeout=60)
        # A computer that stands still for so long that a device seems silent ends a run rightly.
        if program.returncode == 2:
            chair.measure_legs()
            continue
        assert program.returncode == 0, said
        share = share_in_time(said)
        print(f"younger than a period: {share:.3f}")
        if best is None or share > best.share:
            best = Stepped(share, read_mcap(log), json.loads(metrics.read_text()))
        if share >= IN_TIME:
            break
    assert best is not None
    return best


# --- a run that goes well


def test_a_step_on_the_emulated_chair_holds_its_bounds(stepped, chair):
    assert stepped.metrics["passed"] is True
    assert stepped.metrics["backend"] == "hardware"
    assert chair.is_neutral


def test_branches_track_their_nodes_over_the_bus(stepped):
    log = stepped.log
    # At a sample the node of the one before is due. On the way to a measurement and back some
    # 10 ms pass, in which a branch goes on by a tenth of a millisecond.
    error = log.signals["legs.position"][1:] - log.signals["position_node"][:-1]
    print(f"tracking: {1e3 * np.abs(error).max():.3f} mm")
    # Where others keep the programs waiting, a branch goes on by as much as it moves meanwhile.
    assert 1e3 * np.abs(error).max() < (0.5 if stepped.share >= IN_TIME else 1.5)
    moved = 1e3 * np.ptp(log.signals["legs.position"], axis=0)
    assert moved.min() > 0.9 * LIFT


def test_the_chair_has_truly_lifted_its_body_and_lowered_it_again(stepped, chair):
    log = stepped.log
    begin = log.metadata["wall_time"] + log.time[0]
    end = log.metadata["wall_time"] + log.time[-1]
    stamps, body, lengths = chair.logged("truth.body_position", "truth.position")
    during = (stamps >= begin) & (stamps <= end)
    assert during.sum() > 300
    height = 1e3 * body[during, 2]
    assert height.max() - height[0] == pytest.approx(LIFT, abs=0.2)
    assert height[-1] == pytest.approx(height[0], abs=0.05)
    # The encoders count since their power-on; together with the file they show what is true.
    shown = log.signals["legs.position"][-1]
    np.testing.assert_allclose(shown, lengths[during][-1], atol=2e-5)


def test_currents_tell_the_passengers_weight(stepped):
    log = stepped.log
    assert log.signals["payload_estimated"][-1, 0] == pytest.approx(57.0, abs=1.0)


def test_measurements_are_mostly_younger_than_a_period_when_commands_are_written(stepped):
    if stepped.share < IN_TIME and os.getloadavg()[0] > os.cpu_count():
        pytest.skip("other programs keep this computer busy")
    assert stepped.share >= IN_TIME


def test_units_are_in_the_log(stepped):
    units = stepped.log.metadata["units"]
    assert units["legs.velocity_command"] == "m/s"
    assert units["payload_estimated"] == "kg, m, m"


def test_a_run_begins_where_the_one_before_ended(stepped, here, capsys):
    true = here.wires.get("legs.position")
    assert here.memory.recall() == pytest.approx(true, abs=2e-6)
    assert main(["check", "legs", "--of", "chair-walk", "--seconds", "0.1"]) == 0
    shown = re.search(r"^position: (.*) \(", capsys.readouterr().out, re.MULTILINE)[1]
    assert [float(x) for x in shown.split(",")] == pytest.approx(true, abs=2e-6)


def test_without_the_file_nobody_knows_the_lengths(here, capsys):
    here.memory.path.unlink()
    check = ["check", "legs", "--of", "chair-walk", "--seconds", "0.1"]
    assert main(check) == 2
    line = capsys.readouterr().err
    assert re.fullmatch(r"parapod: error: EPOS2 .*: nobody knows the legs' positions: .*\n", line)
    given = ", ".join(f"{1e3 * x:.3f}" for x in here.wires.get("legs.position"))
    override = f"hardware.drivers.0.position_at_start_mm=[{given}]"
    assert main([*check, "--set", override]) == 0


# --- self-tests


def test_the_chairs_legs_pass_their_self_test(here, capsys):
    command = "check legs --of chair-walk --move 2 --yes --seconds 0.3"
    assert main(command.split()) == 0, capsys.readouterr()
    assert here.is_neutral


def test_a_self_test_stops_at_a_limit_that_is_in_its_way(here, capsys):
    # What the documents have people do, to see that there are limits.
    position = here.wires.get("legs.position")
    low, high = ([1e3 * x + way for x in position] for way in (-5.0, 5.0))
    limits = [
        f"hardware.drivers.0.{key}={value}"
        for key, value in (("position_min_mm", low), ("position_max_mm", high))
    ]
    command = "check legs --of chair-walk --move 3 --yes --seconds 0.1 --set"
    assert main([*command.split(), *limits]) == 1
    out = capsys.readouterr().out
    assert re.search(r"scale_error_percent .*BROKEN", out), out
    reached = float(re.search(r"reached \[m\] +([\d.]+)", out)[1])
    assert 4.5e-3 < reached < 5.01e-3


def test_a_self_test_that_is_too_fast_is_refused_with_what_is_allowed(here, capsys):
    command = "check legs --of chair-walk --move 2 --yes --command 1"
    assert main(command.split()) == 2
    assert "a self-test moves legs with up to 0.02 m/s, not 1 m/s" in capsys.readouterr().err


def test_the_chairs_controller_is_measured_beside_the_computer(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    command = "bench-rt --of chair-walk --rates 50 --seconds 1 --json figures.json"
    assert main(command.split()) == 0
    assert json.loads((tmp_path / "figures.json").read_text())["rates"][0]["rate_hz"] == 50.0


# --- what is refused


def test_an_experiment_without_a_machine_is_refused_with_those_that_have_one(capsys):
    assert main(["emulate", "chair-circle"]) == 2
    assert capsys.readouterr().err == (
        "parapod: error: 'chair-circle' has no machine that can be emulated; 'level' and "
        "'chair-walk' have\n"
    )


def test_without_an_emulator_it_is_said_how_to_begin_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PARAPOD_EMULATOR", str(tmp_path))
    assert main([*STEP]) == 2
    line = capsys.readouterr().err
    assert re.fullmatch(r"parapod: error: !Epos2Legs\.channel = emulator/can, but no .*\n", line)
    assert "begin `parapod emulate chair-walk` in another terminal" in line


def test_the_emulator_says_what_to_run(chair):
    ready = [line for line in chair.said if line.startswith("ready")]
    assert ready == ["ready: in another terminal, parapod run chair-walk --backend hardware"]


# --- drives that misbehave


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("off", r"node 1 does not answer SYNC"),
        ("garbage", r"node \d+ .*"),
        ("unplugged", r"no bus"),
    ],
)
def test_drives_that_fail_end_the_run_within_a_second_and_are_named(here, capsys, kind, words):
    begun = []

    def disturb():
        if here.until(lambda: here.has_power, 20.0):
            time.sleep(1.2)
            here.misbehave("legs", kind)
            begun.append(time.monotonic())

    thread = threading.Thread(target=disturb)
    thread.start()
    assert main([*STEP, PATIENT]) == 2
    took = time.monotonic() - begun[0]
    thread.join()
    errors = [x for x in capsys.readouterr().err.splitlines() if x.startswith("parapod: error")]
    print(f"{kind}: ended after {took:.2f} s")
    assert re.fullmatch(rf"parapod: error: EPOS2 on slcan \S+/can: {words}.*", *errors)
    assert took < 1.0
    assert here.until(lambda: here.is_neutral, 1.0)


# --- programs that are killed


def first(stamps, holds, after):
    """When something held for the first time after an instant [s after it], and from then on."""
    later = stamps > after
    assert holds[later].any()
    last_not = np.flatnonzero(later & ~holds)
    index = last_not[-1] + 1 if last_not.size else np.flatnonzero(later)[0]
    assert index < len(stamps)
    return stamps[index] - after


def test_all_drives_stand_soon_after_the_controller_is_killed(here, capsys):
    program = here.program(sys.executable, "-c", DRIVING)
    line = program.stdout.readline()
    assert line == "driving\n", program.communicate()
    time.sleep(0.6)
    at = time.time()
    program.send_signal(signal.SIGKILL)
    program.communicate()
    time.sleep(0.7)
    stamps, command, brake, lengths = here.logged(
        "legs.velocity_command", "legs.brake", "truth.position"
    )
    before = (stamps > at - 0.2) & (stamps < at - 0.02)
    np.testing.assert_allclose(command[before], 0.02, atol=2e-5)
    assert (brake[before] < 0.5).all()
    stopped = first(stamps, (command == 0.0).all(axis=1) & (brake[:, 0] > 0.5), at)
    still = np.abs(lengths - lengths[-1]).max(axis=1) < 1e-5
    stand = first(stamps, still, at)
    way = 1e3 * np.abs(lengths[-1] - lengths[stamps < at][-1]).max()
    # The heartbeat's timeout of 0.1 s and the ramp; then the lag of the drives.
    assert stopped < 0.2
    assert stand < 0.6
    # The next program does not know where the screws stand.
    assert main(["check", "legs", "--of", "chair-walk", "--seconds", "0.1"]) == 2
    line = capsys.readouterr().err
    assert re.fullmatch(r"parapod: error: positions' file .*: says that .*\n", line)
    assert "measure them, and delete the file" in line
    assert here.is_neutral
    print(
        f"stopped {1e3 * stopped:.0f} ms after the kill, still {1e3 * stand:.0f}, {way:.1f} mm on"
    )
