"""The station with devices behind its ports: the ports, the checks, the order of events."""

import json
import os
import re
import signal
import subprocess
import sys
import textwrap
import threading
import time
from dataclasses import dataclass, field

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import InputPortIndex, OutputPortIndex

from parapod.diagrams import devices
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.devices import NotNeutral
from parapod.diagrams.drivers.driver import Driver
from parapod.diagrams.hardware_scenario import (
    Adis16448SpiImu,
    HardwareScenario,
    NiDaqEncoders,
    NiDaqLegs,
    NotFittedPart,
    SabertoothLegs,
)
from parapod.diagrams.levelling_platform.drivers import Epos2Wheels
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.station import Station
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.extras import EXTRAS
from parapod.systems.hardware.device import Device, DeviceError, DeviceFault
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour
from parapod.systems.hardware.signals import ended_by_signals

PARTS = ("arm", "imu", "legs", "wheels")
LIBRARIES = sorted(EXTRAS)
EXTENSION = (0.401, 0.402, 0.403, 0.404)
SHOWN = {"extension": EXTENSION, "accel": (0.0, 0.0, 9.80665), "mag": (2e-5, 0.0, -4e-5)}


class FakeDevice(Device):
    """Tells a diary what happens to it, and fails when told to."""

    def __init__(self, name, measures, commands, diary=None, fails=()):
        self.name, self.measures, self.commands = f"fake {name}", measures, commands
        self._part, self._fails = name, fails
        self._diary = [] if diary is None else diary
        self.written = []

    def _note(self, event):
        self._diary.append((self._part, event))
        if event in self._fails:
            raise DeviceError(self.name, f"cannot {event}")

    def configure(self):
        self._note("configure")

    def activate(self):
        self._note("activate")

    def read(self):
        if "read" in self._fails:
            raise DeviceError(self.name, "shows nothing", DeviceFault.SILENT)
        return {name: SHOWN.get(name, (0.0,) * size) for name, size in self.measures.items()}

    def write(self, commands):
        self.written.append(commands)

    def neutral(self):
        self._note("neutral")

    def deactivate(self):
        self._note("deactivate")
        self.neutral()

    def close(self):
        self._diary.append((self._part, "close"))


@dataclass
class _Fake(Driver):
    """A driver of a fake; no scenario can name it, as its name begins with an underscore."""

    diary: list = field(default_factory=list)
    fails: tuple = ()
    measures: dict | None = None
    commands: dict | None = None

    def make(self, ports):
        measures = dict(ports.measures) if self.measures is None else self.measures
        commands = dict(ports.commands) if self.commands is None else self.commands
        return FakeDevice(self.part, measures, commands, self.diary, self.fails)


def scenario_of(*drivers):
    return LevellingScenario(backend="hardware", hardware=HardwareScenario(list(drivers)))


def fakes(diary=None, **fails):
    """One fake a part; `fails` tells what each cannot do."""
    diary = [] if diary is None else diary
    return [_Fake(part, diary, tuple(fails.get(part, ()))) for part in PARTS]


def with_fakes(*drivers):
    """These drivers, and fakes for the parts that they are not of."""
    parts = {driver.part for driver in drivers}
    return [*drivers, *(_Fake(part) for part in PARTS if part not in parts)]


# Ports


def described(diagram):
    """The exported ports as (name, size, type), inputs and outputs."""
    inputs = [diagram.get_input_port(InputPortIndex(i)) for i in range(diagram.num_input_ports())]
    outputs = [
        diagram.get_output_port(OutputPortIndex(i)) for i in range(diagram.num_output_ports())
    ]
    return [
        {(port.get_name(), port.size(), port.get_data_type()) for port in ports}
        for ports in (inputs, outputs)
    ]


# What makes no machine


CARD = "PXIe-6363 PXI1Slot2 at unix:"


@pytest.mark.parametrize(
    ("drivers", "said"),
    [
        (
            [*fakes()[:-1], NotFittedPart("wheel")],
            r"hardware.drivers.3.part = 'wheel' is not one of arm, imu, legs, wheels",
        ),
        (
            [driver for driver in fakes() if driver.part != "imu"],
            r"imu.gyro is measured by no driver \(those with part: imu: none\)",
        ),
        (
            with_fakes(NiDaqEncoders()),
            rf"legs.voltage is driven by no driver \(those with part: legs: {CARD}\S*\)",
        ),
        (
            with_fakes(SabertoothLegs()),
            r"legs.extension is measured by no driver \(those with part: legs: [^:]*abertooth.*\)",
        ),
        (
            [driver for driver in fakes() if driver.part != "arm"],
            r"arm.position_command is driven by no driver \(those with part: arm: none\)",
        ),
        (
            with_fakes(NiDaqLegs(), NiDaqEncoders()),
            rf"legs.extension is measured by {CARD}\S* and {CARD}\S*; it must be one",
        ),
        (
            with_fakes(NiDaqLegs(counters="PXI1Slot2/ctr0:2")),
            r"!NiDaqLegs of legs: each of the 4 outputs needs one counter, not .*",
        ),
        (
            with_fakes(
                NiDaqLegs(
                    counters="PXI1Slot2/ctr0:2",
                    outputs="PXI1Slot2/ao0:2",
                    extension_at_start_mm=[410.0] * 4,
                )
            ),
            r"!NiDaqLegs of legs: extension_at_start must be 3 values, not .*",
        ),
        (
            with_fakes(NiDaqLegs(extension_file="")),
            r"!NiDaqLegs of legs: without extension_file it needs extension_at_start_mm",
        ),
        (
            with_fakes(SabertoothLegs(), NiDaqEncoders(extension_file="")),
            r"!NiDaqEncoders of legs: without extension_file it needs extension_at_start_mm",
        ),
        (
            with_fakes(NiDaqLegs(inputs="PXI1Slot2/port0/line0:10")),
            rf"{CARD}\S* has 11 elements of legs.limits, the port 12",
        ),
        (
            with_fakes(SabertoothLegs(addresses=[128]), NiDaqEncoders()),
            r"!SabertoothLegs: 4 legs need 2 addresses, not 1",
        ),
        (
            with_fakes(Epos2Wheels(node_ids=[1, 2, 3])),
            r".*EPOS2.* has 3 elements of wheels.position, the port 4",
        ),
        (
            [*fakes(), _Fake("legs", measures={}, commands={"voltage": 3})],
            r"fake legs has 3 elements of legs.voltage, the port 4",
        ),
        (
            [*fakes(), _Fake("arm", measures={}, commands={"grip": 1})],
            r"fake arm takes arm.grip, which is not a port",
        ),
        (
            with_fakes(NotFittedPart("legs")),
            r"the machine does not work without its legs",
        ),
        (
            with_fakes(NotFittedPart("imu")),
            r"the machine does not work without its imu",
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_drivers_that_make_no_machine_are_refused_in_one_line(drivers, said):
    with pytest.raises(ScenarioError) as caught:
        Station(PLATFORM, scenario_of(*drivers))
    text = str(caught.value)
    assert "\n" not in text
    assert re.fullmatch(rf"(hardware.drivers: )?{said}", text), text
    assert caught.value.key.startswith("hardware.drivers")


def test_two_drivers_may_take_the_same_command():
    station = Station(PLATFORM, scenario_of(*with_fakes(NiDaqEncoders(), SabertoothLegs())))
    taken = [set(thread.device.commands) for thread in station.behind.handle.threads["legs"]]
    assert all("stop" in commands for commands in taken)


def test_a_part_that_is_not_fitted_has_its_ports_and_shows_zeros():
    station = Station(PLATFORM, scenario_of(*with_fakes(NotFittedPart("wheels"))))
    (thread,) = station.behind.handle.threads["wheels"]
    assert thread.device.read() == {"position": (0.0,) * 4, "velocity": (0.0,) * 4}
    assert dict(thread.device.commands) == {"velocity_command": 4, "brake": 1}


# What is imported and opened when


def python(code, *arguments, **options):
    """Runs a program of its own; returns what it prints."""
    # -B: they write no bytecode, whatever has been compiled before.
    command = [sys.executable, "-B", "-c", textwrap.dedent(code), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, **options)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_building_opens_nothing_and_imports_no_drivers_library(tmp_path):
    code = """
        import sys
        from parapod.diagrams.drivers.driver import Driver
        from parapod.diagrams.hardware_scenario import HardwareScenario
        from parapod.diagrams.levelling_platform.scenario import LevellingScenario
        from parapod.diagrams.levelling_platform.machine import PLATFORM
        from parapod.diagrams.station import Station

        opened = []

        def hook(event, arguments):
            # What opens a bus opens a file, a socket or a port, or loads code.
            if event in ("socket.connect", "socket.bind", "ctypes.dlopen") or (
                event == "open" and not isinstance(arguments[0], int)
                and not str(arguments[0]).endswith((".py", ".pyc"))
            ):
                opened.append((event, arguments[0]))

        tags = Driver.variants()
        rest = [tags["Epos2Wheels"](), tags["NotFittedPart"]("arm")]
        machines = [
            [tags["NiDaqLegs"](), tags["Adis16448SpiImu"](), *rest],
            [tags["SabertoothLegs"](), tags["NiDaqEncoders"](), tags["Adis16448IioImu"](), *rest],
        ]
        sys.addaudithook(hook)
        for drivers in machines:
            hardware = HardwareScenario(drivers)
            Station(PLATFORM, LevellingScenario(backend="hardware", hardware=hardware))
        assert not opened, opened
        print(*sorted({name.partition(".")[0] for name in sys.modules} & set(sys.argv[1:])))
    """
    place = os.environ | {"PARAPOD_EMULATOR": str(tmp_path)}
    assert python(code, *LIBRARIES, env=place).split() == []


BLOCKED = """
    import importlib, io, json, pkgutil, sys
    from importlib.abc import MetaPathFinder

    class Blocked(MetaPathFinder):
        def find_spec(self, name, path=None, target=None):
            if name.partition(".")[0] in sys.argv[1:]:
                raise ImportError(f"No module named '{name}'", name=name)

    sys.meta_path.insert(0, Blocked())
"""


def test_without_the_optional_libraries_everything_is_imported_and_simulation_works():
    code = """
        import parapod.diagrams, parapod.sims, parapod.systems

        for package in (parapod.systems, parapod.diagrams, parapod.sims):
            for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
                if not info.name.endswith("__main__"):
                    importlib.import_module(info.name)

        from pathlib import Path
        from rich.console import Console
        from parapod.diagrams.levelling_platform.scenario import LevellingScenario
        from parapod.sims.output.options import RunOptions
        from parapod.sims.levelling_platform.level import Level

        scenario = LevellingScenario(backend="kinematic")
        scenario.ground.roll_deg, scenario.ground.pitch_deg = 0.3, 0.2
        scenario.job.initial_extension_mm, scenario.job.estimate_at = 405.0, 1.5
        scenario.job.settled_after, scenario.job.end = 1.5, 2.0
        scenario.job.arm.start, scenario.job.arm.duration = 0.5, 0.5
        result = Level("level").execute(scenario, RunOptions(console=Console(file=io.StringIO())))
        print(result.as_json()["ground_roll_error_deg"])
    """
    out = python(textwrap.dedent(BLOCKED) + textwrap.dedent(code), *LIBRARIES)
    assert float(out) < 0.2


# The order of events


def events(diary, *names):
    """The diary's entries with one of these events."""
    return [entry for entry in diary if entry[1] in names]


def active_parts(diary, **fails):
    return Station(PLATFORM, scenario_of(*fakes(diary, **fails)))


def test_all_devices_are_configured_before_any_is_activated():
    diary = []
    with active_parts(diary).active():
        began = list(diary)
    first = [event for _, event in began]
    assert first == ["configure"] * len(PARTS) + ["activate"] * len(PARTS)


def test_at_the_end_all_are_deactivated_and_then_closed_in_reverse_order():
    diary = []
    with active_parts(diary).active():
        order = [part for part, _ in events(diary, "activate")]
        diary.clear()
    backwards = list(reversed(order))
    assert events(diary, "deactivate") == [(part, "deactivate") for part in backwards]
    assert events(diary, "neutral") == [(part, "neutral") for part in backwards]
    assert diary[-len(PARTS) :] == [(part, "close") for part in backwards]


def test_an_exception_inside_leaves_all_neutral_and_closed_in_reverse_order():
    diary = []
    station = active_parts(diary)

    def fly():
        with station.active():
            diary.clear()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fly()
    backwards = list(reversed(PARTS))
    assert events(diary, "neutral") == [(part, "neutral") for part in backwards]
    assert diary[-len(PARTS) :] == [(part, "close") for part in backwards]


def test_a_signal_at_the_end_leaves_all_neutral_and_closed(monkeypatch):
    diary = []
    station = active_parts(diary)
    first = station.behind.handle.all_threads[-1]
    stop = first.stop
    monkeypatch.setattr(first, "stop", lambda: (os.kill(os.getpid(), signal.SIGTERM), stop())[1])
    with ended_by_signals(), pytest.raises(KeyboardInterrupt, match="SIGTERM"), station.active():
        diary.clear()
    backwards = list(reversed(PARTS))
    assert events(diary, "neutral") == [(part, "neutral") for part in backwards]
    assert diary[-len(PARTS) :] == [(part, "close") for part in backwards]


@pytest.mark.parametrize("part", PARTS)
def test_a_device_that_refuses_to_be_configured_leaves_all_closed_and_none_activated(part):
    diary = []
    station = active_parts(diary, **{part: ("configure",)})
    with pytest.raises(DeviceError, match=f"fake {part}: cannot configure"), station.active():
        pass
    assert events(diary, "activate", "deactivate") == []
    configured = [name for name, _ in events(diary, "configure")]
    assert configured[-1] == part
    assert [name for name, _ in events(diary, "close")] == list(reversed(configured))


@pytest.mark.parametrize("what", ["activate", "read"])
def test_a_device_that_does_not_begin_leaves_all_neutral_and_closed(what):
    diary = []
    station = active_parts(diary, legs=(what,))
    with pytest.raises(DeviceError, match="fake legs"), station.active():
        pass
    activated = [name for name, _ in events(diary, "activate")]
    assert activated[-1] == "legs"
    assert {name for name, _ in events(diary, "neutral")} == set(activated)
    assert {name for name, _ in diary[-len(PARTS) :]} == set(PARTS)
    assert {event for _, event in diary[-len(PARTS) :]} == {"close"}


def test_a_device_that_fails_at_the_end_does_not_keep_others_from_their_end():
    diary = []
    fails = {part: ("deactivate", "neutral") for part in ("legs", "wheels", "imu")}
    station = active_parts(diary, **fails)
    began = time.monotonic()
    # Sensors move nothing.
    live = (
        "fake wheels: cannot deactivate; fake legs: cannot deactivate; OUTPUTS OF fake wheels AND"
    )
    with (
        pytest.raises(NotNeutral, match=f"^{live} fake legs MAY STILL BE LIVE: press the emerg"),
        station.active(),
    ):
        diary.clear()
    assert {part for part, _ in events(diary, "deactivate")} == set(PARTS)
    assert diary[-len(PARTS) :] == [(part, "close") for part in reversed(PARTS)]
    # All have been asked before any was asked again, and those for two seconds.
    asked = [part for part, _ in events(diary, "deactivate")]
    assert set(asked[: len(PARTS)]) == set(PARTS)
    assert {part: asked.count(part) > 10 for part in PARTS} == {
        part: part in ("legs", "wheels") for part in PARTS
    }
    assert time.monotonic() - began >= 2.0


@pytest.mark.parametrize(
    ("ended", "words"),
    [
        (DeviceError("fake imu", "has burst"), "fake imu: has burst"),
        (KeyboardInterrupt(), "interrupted"),
        (ZeroDivisionError("by zero"), "ZeroDivisionError: by zero"),
    ],
)
def test_the_last_line_says_first_what_has_ended_the_work(ended, words, monkeypatch):
    monkeypatch.setattr(devices, "_CONFIRMING", 0.1)
    station = active_parts([], legs=("deactivate", "neutral"))
    (thread,) = station.behind.handle.threads["legs"]
    thread.device.watchdog = "without packets they stop within 0.1 s"

    def work():
        with station.active():
            raise ended

    with pytest.raises(NotNeutral) as caught:
        work()
    assert str(caught.value) == (
        f"{words}; fake legs: cannot deactivate; without packets they stop within 0.1 s"
    )


def test_a_device_that_becomes_neutral_when_it_is_asked_again_is_no_error():
    diary = []
    station = active_parts(diary, legs=("deactivate", "neutral"))
    (thread,) = station.behind.handle.threads["legs"]
    with station.active():
        timer = threading.Timer(0.3, lambda: setattr(thread.device, "_fails", ()))
        timer.start()
    timer.join()
    assert len(events(diary, "deactivate")) > len(PARTS)
    assert events(diary, "neutral")[-1] == ("legs", "neutral")


def test_a_station_can_be_active_again():
    diary = []
    station = active_parts(diary)
    for _ in range(2):
        with station.active():
            station.reset(station.CreateDefaultContext())
    assert [event for _, event in events(diary, "configure", "activate")] == [
        *["configure"] * len(PARTS),
        *["activate"] * len(PARTS),
    ] * 2


# The beginning of a loop


@pytest.fixture
def loop():
    scenario = scenario_of(*fakes())
    scenario.job.estimate_at = 0.5
    return ClosedLoop(PLATFORM, scenario, log=())


def shown(loop, context, name):
    port = loop.ports[name]
    return np.array(port.Eval(port.get_system().GetMyContextFromRoot(context)))


def test_a_station_that_is_not_active_does_not_begin(loop):
    with pytest.raises(DeviceError, match=r"fake \w+: no sample yet"):
        loop.reset(loop.CreateDefaultContext())


def test_the_loop_begins_with_measurements(loop):
    context = loop.CreateDefaultContext()
    assert not shown(loop, context, "legs.extension").any()
    with loop.station.active():
        loop.reset(context)
    np.testing.assert_array_equal(shown(loop, context, "legs.extension"), EXTENSION)
    np.testing.assert_array_equal(shown(loop, context, "imu.accel"), SHOWN["accel"])
    assert not shown(loop, context, "status.fault").any()
    assert (shown(loop, context, "status.age") < 0.1).all()


def test_the_loop_begins_with_neutral_commands_and_without_a_jump(loop):
    simulator = Simulator(loop)
    context = simulator.get_mutable_context()
    (legs,) = loop.station.behind.handle.threads["legs"]
    period = loop.station.scenario.control.period
    voltages, valid = [], []
    with loop.station.active():
        loop.reset(context)
        simulator.Initialize()
        simulator.set_target_realtime_rate(1.0)
        # The ground is known after some samples, which threads bring when they can.
        while sum(valid) < 10 and len(valid) < 500:
            simulator.AdvanceTo((len(valid) + 0.5) * period)
            voltages.append(shown(loop, context, "legs.voltage"))
            valid.append(shown(loop, context, "ground_valid")[0] > 0.5)
    assert legs.device.written[0] == {"voltage": (0.0,) * 4, "stop": (0.0,)}
    assert not np.any(np.array(voltages)[~np.array(valid)])
    begun = np.array(voltages)[valid]
    assert len(begun) >= 5
    # The reference begins where the legs are: no step of a controller, which has volts for it.
    assert np.abs(begun[0]).max() < 0.05
    assert np.abs(np.diff(begun, axis=0)).max() < 0.05


# Emulation


@pytest.fixture
def emulated_card(tmp_path, monkeypatch):
    """emulated_card(driver): files known before, with what they say after it is emulated."""
    pytest.importorskip("nidaqmx")
    monkeypatch.setenv("PARAPOD_EMULATOR", str(tmp_path / "emulator"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "emulator").mkdir()

    def emulate(driver):
        files = ("emulator/extensions.json", "mine.json")
        for file in files:
            (tmp_path / file).write_text('{"extension_m": null}')
        harness = Harness({spec.name: spec.size for spec in (*PLATFORM.inputs, *PLATFORM.outputs)})
        harness.set("legs.extension", EXTENSION)
        driver.emulate(harness, Misbehaviour())
        return {file: json.loads((tmp_path / file).read_text())["extension_m"] for file in files}

    return emulate


@pytest.mark.parametrize("kind", [NiDaqLegs, NiDaqEncoders])
def test_an_emulated_card_knows_the_extensions_of_the_emulated_machine(emulated_card, kind):
    said = emulated_card(kind(extension_file="emulator/extensions.json"))
    assert said == {"emulator/extensions.json": list(EXTENSION), "mine.json": None}


@pytest.mark.parametrize("kept", ["mine.json", ""])
def test_an_emulated_card_leaves_the_file_of_another_machine_alone(emulated_card, kept):
    said = emulated_card(NiDaqLegs(extension_file=kept, extension_at_start_mm=[410.0] * 4))
    assert set(said.values()) == {None}


def test_nobody_guesses_the_extensions_of_a_machine():
    assert NiDaqLegs().extension_at_start_mm is None
    assert NiDaqLegs().extension_at_start is None
    measured = NiDaqLegs(extension_at_start_mm=[400.0, 401.0, 402.0, 403.0])
    assert measured.extension_at_start == pytest.approx((0.4, 0.401, 0.402, 0.403))


def test_default_drivers_are_those_of_the_emulator():
    drivers = LevellingScenario().hardware.drivers
    assert [type(driver) for driver in drivers[:3]] == [NiDaqLegs, Adis16448SpiImu, Epos2Wheels]
