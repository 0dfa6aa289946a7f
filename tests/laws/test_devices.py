"""Laws of all devices, proved for every driver of parapod's own on its emulator.

Emulators run in threads of this process, by a time that stands still while a test works. A law
about time is judged by the computer's own, from what it managed meanwhile: see `judge`.
"""

import gc
import itertools
import json
import math
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import pytest

from parapod.diagrams.drivers.driver import Driver, PartPorts
from parapod.diagrams.machine import list_machines
from parapod.systems.core.errors import MissingExtra, ScenarioError
from parapod.systems.core.extras import EXTRAS, need
from parapod.systems.core.schema import Range, fields_of
from parapod.systems.hardware.adis16448.iiod import is_available
from parapod.systems.hardware.clock import (
    CLOCK,
    EmulatedClock,
    going_by,
    monotonic,
    sleep,
    standing_still,
)
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.emulation.harness import SUPPLY, Harness, Misbehaviour
from parapod.systems.hardware.exclusive import lock_path

SILENT, CORRUPT, UNPLUGGED = DeviceFault.SILENT, DeviceFault.CORRUPT, DeviceFault.UNPLUGGED
MACHINES = list_machines()  # which define drivers of their own
DRIVERS = {
    name: kind
    for name, kind in Driver.variants().items()
    if kind.__module__.startswith("parapod.")
}
# Longest time that a law waits for what must happen [s].
PATIENCE = 60.0
LIBRARIES = sorted(EXTRAS)


def fitted(driver):
    """A driver with what it takes from its machine, if it is one's own."""
    for machine in MACHINES:
        if f".diagrams.{machine.name}." in type(driver).__module__:
            fittings = machine.for_scenario(machine.scenario()).real.fittings
            return driver.fitted(fittings.get(driver.part, {}))
    return driver


@dataclass
class Row:
    """A driver on its emulator.

    Attributes:
        library: that its device needs where it is real.
        settings: of the driver.
        real: settings with which there is no emulator, and no device.
        measures: signals that the machine shows, and their sizes; a name with a dot is that of a
            port of another part.
        commands: signals that the machine takes, and their sizes.
        truth: a signal that it measures, its value, and how exactly it is shown.
        order: a command that moves something.
        rest: what is on the wires to the machine while nothing may move.
        is_held: whether neutral is to stay as it has been commanded, and not zero.
        faults: by misbehaviour, faults that `read` may have.
        timeout: longest time of one call [s].
        is_opened_again: whether it must be configured again after it was unplugged.
        memory: file of its positions.
        passes_on: whether commands reach the machine as they are: limits, and brakes that stop
            axes, are beyond the bus.
        like: driver with the same program and other settings; what is commanded, fails and is
            remembered is proved of that.
    """

    library: str
    settings: dict = field(default_factory=dict)
    real: dict = field(default_factory=dict)
    measures: dict = field(default_factory=dict)
    commands: dict = field(default_factory=dict)
    truth: tuple = ()
    order: dict = field(default_factory=dict)
    rest: dict = field(default_factory=dict)
    is_held: bool = False
    faults: dict = field(default_factory=dict)
    timeout: float = 1.0
    is_opened_again: bool = False
    memory: str = ""
    passes_on: bool = False
    like: str = ""


CARD = {
    "library": "nidaqmx",
    # A busy machine may keep resets from the card's watchdog.
    "settings": {"watchdog_ms": 5000.0},
    "real": {"target": "unix:/nowhere/socket"},
    "measures": {"extension": 4, "velocity": 4, "limits": 12, "emergency_stop": 1},
    "commands": {"voltage": 4, "stop": 1},
    "truth": ("extension", (0.401, 0.412, 0.423, 0.4344), 1e-5),
    # A server that stalls is not told from one that is slow: each call waits for its timeout.
    "faults": {"off": {SILENT}, "unplugged": {UNPLUGGED}},
    "timeout": 0.2,
    "memory": "extensions.json",
}
BUS = {"off": {SILENT}, "garbage": {CORRUPT, SILENT}, "unplugged": {UNPLUGGED}}


def axes(size, **row):
    return {
        "library": "can",
        "real": {"channel": "/dev/not-there"},
        "measures": dict.fromkeys(("position", "velocity", "current"), size),
        "commands": {"velocity_command": size, "brake": 1},
        "truth": ("position", tuple(0.7 + 1e-3 * i for i in range(size)), 1e-4),
        "order": {"velocity_command": (0.02,) * size, "brake": (0.0,)},
        "rest": {"velocity_command": (0.0,) * size, "brake": (1.0,)},
        "faults": BUS,
        # Twelve nodes whose SDO time is over, in the worst case.
        "timeout": 0.3,
        "is_opened_again": True,
    } | row


PATIENT = {"heartbeat_timeout_ms": 1000.0}
TWO_SCREWS = {
    "part": "legs",
    "node_ids": [1, 2],
    "signs": [1, -1],
    "position_min_mm": [600.0] * 2,
    "position_max_mm": [800.0] * 2,
}
TWO_JOINTS = {"part": "joints", "node_ids": [3, 7], "gear": 100.0}
TWO_LOCKS = {
    "lock_nodes": [1, 2],
    "lock_outputs": [1, 4],
    "lock_inputs": [1, 6],
    "clamp_nodes": [2, 1],
    "clamp_outputs": [2, 3],
    "clamp_inputs": [2, 3],
    # Nothing follows here.
    "following_error_mm": 1000.0,
}


def turns(**row):
    """Two joints whose positions are commanded."""
    # Nothing follows here.
    settings = {"following_error_deg": 360.0, "position_at_start_deg": [0.0] * 2}
    ends = {"position_min_deg": [-60.0] * 2, "position_max_deg": [60.0] * 2}
    return axes(
        2,
        **{
            "settings": PATIENT | TWO_JOINTS | settings | ends,
            "measures": dict.fromkeys(("position", "velocity"), 2),
            "commands": {"position_command": 2, "brake": 1},
            "order": {"position_command": (0.72, 0.68), "brake": (0.0,)},
            "rest": {"brake": (1.0,)},
            "is_held": True,
        }
        | row,
    )


def limbs(count, **row):
    """A centre's legs, locks and clamps."""
    legs, locks = 2 * count, 4 * count
    return axes(
        legs,
        settings=PATIENT | {"following_error_mm": 100.0},
        memory="positions.json",
        measures=dict.fromkeys(("position", "velocity", "current"), legs)
        | {"emergency_stop": 1, "locks.closed": locks, "clamps.closed": count},
        commands={
            "position_command": legs,
            "brake": 1,
            "locks.command": locks,
            "clamps.command": count,
        },
        truth=("position", tuple(0.5 + 1e-3 * i for i in range(legs)), 1e-4),
        order={
            "position_command": (0.52,) * legs,
            "brake": (0.0,),
            "locks.command": (0.0,) * locks,
            "clamps.command": (1.0,) * count,
        },
        rest={"brake": (1.0,), "locks.command": (1.0,) * locks, "clamps.command": (1.0,) * count},
        is_held=True,
        **row,
    )


IMU = {"gyro": 3, "accel": 3, "mag": 3}
TURNING = ("gyro", (0.1, -0.2, 0.3), 1e-3)
ON_A_BUS = Row(
    library="",
    real={"lcm_url": "udpm://239.255.76.67:7667?ttl=0"},
    measures={"position": 2, "velocity": 2},
    commands={"velocity_command": 2, "brake": 1},
    truth=("position", (0.7, -0.3), 1e-9),
    order={"velocity_command": (0.02, 0.01), "brake": (0.0,)},
    rest={"velocity_command": (0.0, 0.0), "brake": (1.0,)},
    faults={"off": {SILENT}, "unplugged": {SILENT}, "garbage": {CORRUPT}},
    timeout=0.1,
    passes_on=True,
)
ROWS = {
    "NiDaqLegs": Row(
        **CARD,
        order={"voltage": (6.0,) * 4, "stop": (0.0,)},
        rest={"voltage": (0.0,) * 4, "stop": (1.0,)},
    ),
    "NiDaqEncoders": Row(**CARD, order={"stop": (0.0,)}, rest={"stop": (1.0,)}),
    "NiDaqForceCells": Row(
        library="nidaqmx",
        # A step of the converter is 30 uN.
        settings={"newton_per_volt": [0.1, -0.1, 0.1]},
        real={"target": "unix:/nowhere/socket"},
        measures={"force": 3},
        truth=("force", (0.1, -0.25, 0.4), 1e-3),
        faults={"off": {SILENT}, "unplugged": {UNPLUGGED}},
        timeout=0.2,
    ),
    "SabertoothLegs": Row(
        library="serial",
        real={"port": "/dev/not-there"},
        commands={"voltage": 4, "stop": 1},
        order={"voltage": (6.0,) * 4, "stop": (0.0,)},
        rest={"voltage": (0.0,) * 4},
        faults={"unplugged": {UNPLUGGED}},
        is_opened_again=True,
    ),
    "Epos2Axes": Row(
        **axes(2, settings=PATIENT | {"part": "joints", "node_ids": [3, 7], "gear": 100.0})
    ),
    "Epos2Wheels": Row(**axes(4, settings=PATIENT, like="Epos2Axes")),
    "Epos2Screws": Row(**axes(2, settings=PATIENT | TWO_SCREWS, memory="positions.json")),
    "Epos2PositionScrews": Row(
        **axes(
            2,
            settings=PATIENT | TWO_SCREWS | TWO_LOCKS,
            memory="positions.json",
            measures=dict.fromkeys(
                ("position", "velocity", "current", "locks.closed", "clamps.closed"), 2
            ),
            commands={"position_command": 2, "brake": 1, "locks.command": 2, "clamps.command": 2},
            order={
                "position_command": (0.72, 0.68),
                "brake": (0.0,),
                "locks.command": (0.0, 0.0),
                "clamps.command": (1.0, 1.0),
            },
            rest={"brake": (1.0,), "locks.command": (1.0, 1.0), "clamps.command": (1.0, 1.0)},
            is_held=True,
        )
    ),
    "Epos2ForceSlides": Row(
        **axes(
            2,
            settings=PATIENT | TWO_SCREWS,
            memory="positions.json",
            commands={"force_command": 2, "brake": 1},
            order={"force_command": (20.0, -50.0), "brake": (0.0,)},
            rest={"force_command": (0.0, 0.0), "brake": (1.0,)},
        )
    ),
    "Epos2TorqueAxes": Row(
        **axes(
            2,
            settings=PATIENT | TWO_JOINTS | {"signs": [1, -1]},
            commands={"torque_command": 2, "brake": 1},
            order={"torque_command": (2.0, -5.0), "brake": (0.0,)},
            rest={"torque_command": (0.0, 0.0), "brake": (1.0,)},
        )
    ),
    "Epos2PositionAxes": Row(**turns()),
    "Epos2Arm": Row(
        **turns(
            commands={"position_command": 2},
            order={"position_command": (0.72, 0.68)},
            rest={},
            like="Epos2PositionAxes",
        )
    ),
    "Epos2Sliders": Row(
        **axes(
            3,
            settings=PATIENT | {"following_error_mm": 1000.0},
            memory="sliders.json",
            measures=dict.fromkeys(("position", "velocity", "current"), 3) | {"emergency_stop": 1},
            commands={"position_command": 3, "brake": 1},
            order={"position_command": (0.71, 0.69, 0.7), "brake": (0.0,)},
            rest={"brake": (1.0,)},
            is_held=True,
            like="Epos2PositionScrews",
        )
    ),
    "Epos2MotorScrews": Row(
        **axes(
            3,
            settings=PATIENT | {"following_error_mm": 1000.0},
            memory="motors.json",
            measures=dict.fromkeys(("position", "velocity", "current"), 3) | {"emergency_stop": 1},
            commands={"position_command": 3, "brake": 1},
            truth=("position", (0.01, -0.011, 0.012), 1e-4),
            order={"position_command": (0.02, -0.03, 0.04), "brake": (0.0,)},
            rest={"brake": (1.0,)},
            is_held=True,
            like="Epos2PositionScrews",
        )
    ),
    "Epos2MotorAxes": Row(
        **turns(
            like="Epos2PositionAxes",
            measures=dict.fromkeys(("position", "velocity", "current"), 2),
        )
    ),
    "Epos2HipSlide": Row(
        **axes(
            1,
            settings=PATIENT,
            memory="hip.json",
            commands={"force_command": 1, "brake": 1},
            order={"force_command": (20.0,), "brake": (0.0,)},
            rest={"force_command": (0.0,), "brake": (1.0,)},
            like="Epos2ForceSlides",
        )
    ),
    "Epos2Belt": Row(
        **axes(
            1,
            settings=PATIENT,
            measures=dict.fromkeys(("position", "velocity"), 1),
            order={"velocity_command": (0.2,), "brake": (0.0,)},
            rest={"velocity_command": (0.0,), "brake": (1.0,)},
        )
    ),
    "Epos2CentreLegs": Row(**limbs(3, like="Epos2PositionScrews")),
    "Epos2Legs": Row(
        **axes(
            12,
            settings=PATIENT,
            memory="positions.json",
            measures=dict.fromkeys(("position", "velocity", "current"), 12)
            | {"emergency_stop": 1},
            like="Epos2Screws",
        )
    ),
    "Adis16448SpiImu": Row(
        library="spidev",
        real={"address": "/dev/spidev77.7"},
        measures=IMU,
        truth=TURNING,
        faults={"off": {SILENT}, "garbage": {CORRUPT}, "unplugged": {UNPLUGGED}},
        timeout=0.1,
    ),
    "Adis16448IioImu": Row(
        library="iio",
        real={"uri": "ip:127.0.0.1:1"},
        measures=IMU,
        truth=TURNING,
        faults={"off": {SILENT}, "unplugged": {UNPLUGGED}},
        timeout=0.5,
    ),
    "LcmPart": ON_A_BUS,
    "Ros2Part": replace(ON_A_BUS, library="rclpy", real={"ros2_graph": "ros2://77"}),
    "NotFittedPart": Row(library="", measures={"angle": 1}, commands={"position_command": 1}),
}
# Drives of other makers.
for _name, _drive in (
    ("Epos2Axes", "epos4"),
    ("Epos2PositionAxes", "nanotec"),
    ("Epos2TorqueAxes", "elmo"),
):
    DRIVERS[f"{_name} {_drive}"] = DRIVERS[_name]
    ROWS[f"{_name} {_drive}"] = replace(
        ROWS[_name], settings=ROWS[_name].settings | {"drive": _drive}
    )
EMULATED = [name for name in ROWS if name != "NotFittedPart"]
WITH_LIBRARY = [name for name in EMULATED if ROWS[name].library]
PROGRAMS = [name for name in EMULATED if not ROWS[name].like]
DRIVING = [name for name in PROGRAMS if ROWS[name].order]
MEASURING = [name for name in EMULATED if ROWS[name].truth]
# Units of commands that are switches, and units of commands, with and without their part.
SWITCHING = {"-", "0/1"}
UNITS = {
    name: port.unit
    for machine in MACHINES
    for port in machine.inputs
    for name in (port.name, port.name.partition(".")[2])
}
# Numbers that no controller means by a switch's 0 or 1.
SENSELESS = (math.nan, math.inf, -math.inf, 1e300, -1e300, 2.0, -1.0)
# Largest magnitude that may reach the machine, whatever is commanded.
LARGEST = {
    "voltage": lambda driver: driver.supply_voltage,
    "velocity_command": lambda driver: driver.max_velocity,
    "force_command": lambda driver: driver.max_force,
    "torque_command": lambda driver: driver.max_force,
    "position_command": lambda driver: max(driver.strokes[1]),
}
OBEYING = [
    name
    for name in DRIVING
    if not ROWS[name].passes_on and ("stop" not in ROWS[name].order or len(ROWS[name].order) > 1)
]
FAULTS = [(name, kind) for name in PROGRAMS for kind in ROWS[name].faults]
REMEMBERING = [name for name in PROGRAMS if ROWS[name].memory]


def until(condition, timeout=PATIENCE):
    """Waits for a condition; a device that fails has not fulfilled it.

    Where the machine sleeps twice as long as it is asked to, nothing is proved.
    """
    deadline, said = time.monotonic() + timeout, "it is not so"
    asked = slept = 0.0
    while True:
        try:
            if condition():
                return
        except DeviceError as error:
            said = str(error)
        began = time.monotonic()
        if began > deadline:
            if slept > 2.0 * asked:
                pytest.skip(f"{said}; the machine slept {slept:.2f} s in place of {asked:.2f} s")
            raise AssertionError(said)
        sleep(1e-3)
        asked, slept = asked + 1e-3, slept + time.monotonic() - began


def port(part, signal):
    """Name of the port of a device's signal."""
    return signal if "." in signal else f"{part}.{signal}"


def wires(row, part):
    """Sizes of the wires of a row by their names."""
    return {port(part, s): size for s, size in {**row.measures, **row.commands}.items()}


class Rig:
    """A driver, its emulator and the wires behind it."""

    def __init__(self, name, **settings):
        self.row = row = ROWS[name]
        self.driver = fitted(DRIVERS[name](**row.settings | settings))
        switches = frozenset(s for s in row.commands if UNITS.get(s) in SWITCHING)
        self.ports = PartPorts(row.measures, row.commands, switches)
        self.misbehaviour = Misbehaviour()
        idle = {port(self.driver.part, s): float(s in switches) for s in row.commands}
        self.harness = Harness(wires(row, self.driver.part), idle)
        if row.memory:
            self.set(*row.truth[:2])

    def device(self, **settings):
        values = {**vars(self.driver), **settings}
        return type(self.driver)(**values).make(self.ports)

    def set(self, signal, values):
        self.harness.set(port(self.driver.part, signal), values)

    def wire(self, signal):
        return self.harness.get(port(self.driver.part, signal))

    def begin(self, kind):
        self.misbehaviour.begin(kind, monotonic())

    def is_at_rest(self):
        return all(self.wire(name) == value for name, value in self.row.rest.items())

    def moves(self, device):
        """Writes and reads until the order has arrived on the wires."""

        def arrived():
            device.read()
            device.write(self.row.order)
            return all(
                self.wire(name) == pytest.approx(value, abs=0.1 if name == "voltage" else 2e-3)
                for name, value in self.row.order.items()
            )

        until(arrived)


@pytest.fixture
def place(monkeypatch):
    """The emulator's folder; the path of a Unix socket is short."""
    with tempfile.TemporaryDirectory(prefix="dev") as folder:
        monkeypatch.setenv("PARAPOD_EMULATOR", folder)
        yield folder


@pytest.fixture
def own_time():
    """Has a `rig` go by the computer's clock, and devices be as silent as they are."""


@pytest.fixture
def rig(request, place):
    """The driver named by the parameter, and its emulator at work."""
    name, settings = request.param, {}
    if name == "Adis16448IioImu":
        try:
            need("iio")
        except MissingExtra as error:
            pytest.skip(str(error))
        if (reason := is_available()) is not None:
            pytest.skip(f"iiod cannot run here: {reason}")
        with socket.create_server(("127.0.0.1", 0)) as free:
            settings["uri"] = f"ip:127.0.0.1:{free.getsockname()[1]}"
    with ExitStack() as stack:
        if "own_time" not in request.fixturenames:
            stack.enter_context(going_by(EmulatedClock(Path(place, CLOCK), 1.0)))
            stack.enter_context(standing_still())
        rig = Rig(name, **settings)
        stack.enter_context(rig.driver.emulate(rig.harness, rig.misbehaviour))
        yield rig


@pytest.fixture(scope="module", autouse=True)
def collected():
    """Destroys what other tests have left here: Meshcat aborts when a device's thread does it."""
    gc.collect()


def each(names):
    return pytest.mark.parametrize("rig", names, indirect=True)


@pytest.fixture
def device(rig):
    """The rig's device, to be configured; closed in the end."""
    with ExitStack() as stack:
        made = rig.device()
        stack.callback(made.close)
        yield made


def configured(device):
    """Configures a device, also when the machine is busy for a moment."""

    def done():
        device.configure()
        return True

    until(done)
    return device


def activated(device):
    """Configures a device and gives it power, also when the machine is busy for a moment."""
    configured(device)
    until(lambda: device.activate() is None)
    return device


def reads(device):
    """The first reading that is none of a busy moment."""
    readings = []
    until(lambda: readings.append(device.read()) is None)
    return readings[0]


def refusal(rig, words):
    """Words of a device that must not be configured, when no busy moment prevents it."""
    said = []

    def refused():
        with pytest.raises(DeviceError) as caught:
            rig.device().configure()
        said[:] = [str(caught.value)]
        return re.search(words, said[0])

    until(refused)
    return said[0]


@contextmanager
def opened(device):
    """`with device:`, also when the machine is busy for a moment."""
    with ExitStack() as stack:
        until(lambda: stack.enter_context(device) is device)
        yield device


# What there is


def test_every_driver_has_its_row():
    assert set(ROWS) == set(DRIVERS)
    for name, row in ROWS.items():
        if row.like:
            written = {key for key in vars(DRIVERS[name]) if not key.startswith("__")}
            assert issubclass(DRIVERS[name], DRIVERS[row.like])
            settings = {field.name for field in fields(DRIVERS[row.like])}
            # By the others it is only told, or takes fewer commands.
            assert written <= settings | {"axis_names", "former", "has_brake", "measures_current"}


@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.name)
def test_drivers_of_a_machine_are_proved_here(machine):
    assert {type(driver).__name__ for driver in machine.scenario().hardware.drivers} <= set(ROWS)


@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.name)
def test_emulators_of_a_machines_own_drivers_work_on_its_wires(place, machine):
    """Those that a scenario may name, too."""
    sizes = {spec.name: spec.size for spec in (*machine.inputs, *machine.outputs)}
    usual = machine.scenario().hardware.drivers
    given = {type(driver): driver for driver in usual}
    for name, kind in DRIVERS.items():
        if f".diagrams.{machine.name}." in kind.__module__:
            driver, harness = fitted(given.get(kind, kind())), Harness(sizes | {SUPPLY: 1})
            with driver.emulate(harness, Misbehaviour()):
                for signal, value in ROWS[name].rest.items():
                    if signal == "brake":
                        assert harness.get(port(driver.part, signal)) == value, name


@pytest.mark.parametrize("name", EMULATED)
def test_part_names_the_wires_of_the_emulator(place, name):
    if name == "Adis16448IioImu" and (reason := is_available()) is not None:
        pytest.skip(f"iiod cannot run here: {reason}")
    row = ROWS[name]
    settings = row.settings | ({"uri": "ip:127.0.0.1:1"} if "Iio" in name else {})
    driver = replace(fitted(DRIVERS[name](**settings)), part="elsewhere")
    driver.emulate(Harness(wires(row, "elsewhere")), Misbehaviour())


# Nothing is loaded or opened before it is needed

LOADED = """
import importlib, sys
importlib.import_module(f"parapod.diagrams.{sys.argv[1]}.scenario")
print(*(name for name in sys.modules if name.startswith("parapod.systems.hardware.")))
print(*(name for name in sys.argv[2:] if name in sys.modules))
"""


@pytest.mark.parametrize("machine", ["levelling_platform", "walking_chair"])
def test_scenario_loads_settings_and_neither_devices_nor_emulators_nor_libraries(machine):
    run = [sys.executable, "-c", LOADED, machine, *LIBRARIES]
    ours, theirs = subprocess.run(run, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )[:2]
    modules = {name.removeprefix("parapod.systems.hardware.") for name in ours.split()}
    allowed = {"addresses", "soft_limits", "cia402.switches", "buses", "buses.address"}
    packages = {name.partition(".")[0] for name in modules if name.endswith(".settings")}
    assert len(packages) == 4
    assert {m for m in modules if not m.endswith(".settings")} <= allowed | packages
    assert theirs == ""


@pytest.mark.parametrize("name", ROWS)
def test_making_a_device_opens_and_loads_nothing(place, name, monkeypatch):
    for library in LIBRARIES:
        monkeypatch.setitem(sys.modules, library, None)
    rig = Rig(name)
    made = rig.device()
    assert os.listdir(place) == []
    made.close()
    made.close()


@pytest.mark.parametrize("name", WITH_LIBRARY)
def test_missing_library_is_named_with_the_command_that_installs_it(place, name, monkeypatch):
    library = ROWS[name].library
    monkeypatch.setitem(sys.modules, library, None)
    real = {} if library == "iio" else ROWS[name].real
    with pytest.raises(MissingExtra) as caught:
        Rig(name, **real).device().configure()
    assert str(caught.value).endswith(f'pip install "parapod[{EXTRAS[library]}]"')


@pytest.mark.parametrize("name", [name for name in EMULATED if name != "Adis16448IioImu"])
def test_what_no_two_programs_may_open_follows_from_the_address(place, name):
    # The kernel's driver of a sensor may be read by several.
    assert place in Rig(name).device().place
    (real,) = ROWS[name].real.values()
    assert real in Rig(name, **ROWS[name].real).device().place


@pytest.mark.parametrize("name", [name for name in EMULATED if name != "Adis16448IioImu"])
def test_one_address_by_two_names_has_one_lock(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tty").touch()
    (tmp_path / "adapter").symlink_to("tty")
    names = {
        "channel": ("adapter", f"{tmp_path}/adapter", f"{tmp_path}/tty@115200"),
        "port": ("adapter", f"{tmp_path}/adapter", f"{tmp_path}/tty"),
        "address": ("0.0", "/dev/spidev0.0"),
        "target": ("localhost:31763", "127.0.0.1:31763", "[::1]:31763"),
        "ros2_graph": ("ros2://7", "ros2://7?range=subnet", "ros2://7"),
        "lcm_url": ("", "udpm://239.255.76.67:7667", "udpm://239.255.76.67:7667?ttl=0"),
    }
    (key,) = ROWS[name].real
    made = [Rig(name, **{key: address}).device() for address in names[key]]
    assert len({lock_path(device.place) for device in made}) == 1


def test_network_interface_is_no_file_of_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = Rig("Epos2Axes", interface="socketcan", channel="can0").device().place
    (tmp_path / "can0").touch()
    after = Rig("Epos2Axes", interface="socketcan", channel="can0").device().place
    assert lock_path(before) == lock_path(after) == lock_path("can0")


# Settings


@pytest.mark.parametrize("name", ROWS)
def test_number_outside_its_range_is_refused_with_its_key(name):
    driver = DRIVERS[name]()
    for key, (kind, rule) in fields_of(DRIVERS[name]).items():
        if not isinstance(rule, Range):
            continue
        is_list = "list" in str(kind)
        for bad in (rule.low - 1, rule.high + 1, math.nan, math.inf):
            value = [bad] * (rule.length or 1) if is_list else bad
            with pytest.raises(ScenarioError, match=rf"^{key}.* {re.escape(str(rule))}"):
                setattr(driver, key, value)


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("NiDaqLegs", {"outputs": "ao0:3"}, "does not name channels"),
        ("NiDaqLegs", {"inputs": ""}, "does not name channels"),
        ("NiDaqLegs", {"outputs": "Other/ao0:3"}, "channels are of 2 cards"),
        ("NiDaqLegs", {"outputs": "PXI1Slot2/ao0:2"}, "3 outputs needs one counter, not"),
        ("NiDaqLegs", {"extension_at_start_mm": [1.0]}, "extension_at_start must be 4 values"),
        ("NiDaqLegs", {"stop_input": "Other/port0/line13"}, "channels are of 2 cards"),
        ("NiDaqLegs", {"stop_input": "PXI1Slot2/port0/line13:14"}, "must be one line, not PXI1"),
        ("NiDaqLegs", {"watchdog_ms": 10.0}, "watchdog_ms must be 0 or at least 20, not 10"),
        ("NiDaqLegs", {"extension_file": ""}, "it needs extension_at_start_mm"),
        ("NiDaqForceCells", {"channels": "ai0:2"}, "does not name channels"),
        ("NiDaqForceCells", {"channels": "PXI1Slot2/ai0:1,A/ai2"}, "channels are of 2 cards"),
        ("NiDaqForceCells", {"zero_V": [0.0]}, "zero_V must be 3 values, not 1"),
        ("NiDaqForceCells", {"newton_per_volt": [1.0, 0.0, 1.0]}, "newton_per_volt must not be 0"),
        ("SabertoothLegs", {"addresses": [128, 128]}, "different ones of 128..135, not"),
        ("SabertoothLegs", {"addresses": [127, 128]}, "different ones of 128..135, not"),
        ("SabertoothLegs", {"serial_timeout_ms": 150.0}, "multiple of 0.1 s"),
        ("SabertoothLegs", {"baud": 2400}, "refresh_interval must be 0.0833 s"),
        ("Epos2Axes", {"node_ids": [1, 1]}, "node ids must be different ones of 1..127"),
        ("Epos2Axes", {"node_ids": []}, "node ids must be different ones of 1..127"),
        ("Epos2Wheels", {"node_ids": [127]}, "node ids must be different ones of 1..127"),
        ("Epos2Screws", {"stop_node": 3}, "stop_node must be one of the node_ids or null, not 3"),
        ("Epos2Screws", {"stop_node": 1}, "there must be a port legs.emergency_stop"),
        ("Epos2Screws", {"signs": [1]}, "signs must be 2 times 1 or -1"),
        ("Epos2Legs", {"signs": [0] * 12}, "signs must be 12 times 1 or -1"),
        ("Epos2Legs", {"position_min_mm": [900.0] * 12}, "limits of axis 1 must be finite"),
        ("Epos2Screws", {"position_at_start_mm": [700.0]}, "must be 2 values, not"),
        ("Epos2Screws", {"position_max_mm": [800.0]}, "2 lower limits and 1 upper"),
        ("Epos2Legs", {"position_file": ""}, "it needs a position_file"),
        ("Epos2PositionScrews", {"position_min_mm": [900.0] * 2}, "limits of axis 1 must be fini"),
        ("Epos2PositionScrews", {"position_max_mm": [800.0]}, "2 lower limits and 1 upper"),
        ("Epos2PositionScrews", {"position_file": ""}, "it needs a position_file"),
        (
            "Epos2PositionScrews",
            {"lock_inputs": [1]},
            "must be of the same length, not 2, 2 and 1",
        ),
        ("Epos2PositionScrews", {"lock_nodes": [1, 3]}, "lock_nodes must be of the node_ids, no"),
        ("Epos2ForceSlides", {"current_limit_a": 1.0}, "force or torque is 400, but current_lim"),
        ("Epos2ForceSlides", {"position_file": ""}, "it needs a position_file"),
        ("Epos2TorqueAxes", {"position_min_deg": [0.0] * 2}, "must be given both, or neither"),
        ("Adis16448SpiImu", {"address": "spidev"}, "address must be as"),
        ("Adis16448IioImu", {"uri": "localhost"}, "uri must be as"),
    ],
)
def test_senseless_settings_are_refused_in_one_line_with_the_driver(place, name, settings, words):
    with pytest.raises(ScenarioError, match=words) as caught:
        Rig(name, **settings).device()
    text, part = str(caught.value), Rig(name).driver.part
    assert text.startswith(f"hardware.drivers: !{name} of {part}: ")
    assert "\n" not in text


@pytest.mark.parametrize("name", EMULATED)
def test_real_address_is_not_emulated(place, name):
    real = {"uri": "ip:10.0.0.7"} if "Iio" in name else ROWS[name].real
    rig = Rig(name, **real)
    with pytest.raises(
        ScenarioError, match=rf"^!{DRIVERS[name].__name__}\.\w+ = .* is not an address of the emul"
    ):
        rig.driver.emulate(rig.harness, rig.misbehaviour)


# Life


@pytest.mark.parametrize("name", EMULATED)
def test_device_that_is_not_there_is_named_in_time_and_not_configured(place, name, judge):
    row = ROWS[name]
    try:
        if row.library:
            need(row.library)
    except MissingExtra as error:
        pytest.skip(str(error))
    made = Rig(name, **row.real).device()
    with judge() as judged, pytest.raises(DeviceError) as caught:
        made.configure()
    assert caught.value.fault is UNPLUGGED
    (address,) = row.real.values()
    assert address in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(DeviceError, match="not configured"):
        made.read()
    judged.check(2.0)


@each(PROGRAMS)
def test_device_that_is_not_configured_says_so_and_can_be_closed(rig, device):
    for again in (False, True):
        if again:
            configured(device).close()
        for call in (device.read, lambda: device.write(rig.row.order)):
            if call == device.read or rig.row.order:
                with pytest.raises(DeviceError, match="not configured") as caught:
                    call()
                assert caught.value.fault is UNPLUGGED
        device.close()


@each(EMULATED)
def test_signals_are_those_announced_and_ports_of_the_part(rig, device):
    measured = reads(configured(device))
    assert {name: len(values) for name, values in measured.items()} == dict(device.measures)
    shown = {name: size for name, size in device.measures.items() if name != "temperature"}
    assert shown.items() <= rig.row.measures.items()
    assert device.commands == {name: rig.row.commands[name] for name in rig.row.order}
    assert all(math.isfinite(value) for values in measured.values() for value in values)


@each(PROGRAMS)
def test_device_can_be_configured_again(rig, device):
    for _ in range(2):
        reads(configured(device))


@each(MEASURING)
def test_truth_arrives(rig, device):
    signal, values, error = rig.row.truth
    configured(device)
    rig.set(signal, values)
    until(lambda: device.read()[signal] == pytest.approx(values, abs=error))


# Commands


@each(DRIVING)
def test_nothing_moves_before_the_device_is_active(rig, device):
    configured(device)
    for _ in range(20):
        until(lambda: device.write(rig.row.order) is None)
        assert rig.is_at_rest()
        sleep(2e-3)
    rig.moves(activated(device))


@each(OBEYING)
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_command_that_is_not_finite_is_neutral(rig, device, bad):
    activated(device)
    rig.moves(device)
    kept = ("stop", "brake")
    (signal,) = (name for name in rig.row.order if name not in kept and "." not in name)
    first, *others = rig.row.order[signal]
    neutral = first if rig.row.is_held else 0.0
    near = pytest.approx([neutral, *others], abs=0.1 if signal == "voltage" else 2e-3)

    def arrived():
        device.read()
        device.write(rig.row.order | {signal: (bad, *others)})
        return list(rig.wire(signal)) == near

    until(arrived)


@each(OBEYING)
@pytest.mark.parametrize("bad", [1e300, -1e300])
def test_absurd_command_is_limited(rig, device, bad):
    activated(device)
    rig.moves(device)
    (signal,) = LARGEST.keys() & rig.row.order
    order = rig.row.order | {signal: (bad,) * rig.row.commands[signal]}
    largest = LARGEST[signal](rig.driver) * (1.0 + 1e-3)  # whole counts, rpm or mA
    for _ in range(20):
        until(lambda: device.read() is not None and device.write(order) is None)
        assert all(abs(value) <= largest for value in rig.wire(signal))
        sleep(2e-3)


@each(DRIVING)
def test_switches_are_declared_with_their_safe_side(rig, device):
    switches = {signal for signal in device.commands if UNITS[signal] in SWITCHING}
    assert set(device.fail_safe) == switches
    assert switches


@each(DRIVING)
def test_switch_that_is_commanded_neither_0_nor_1_goes_to_its_safe_side(rig, device):
    released = rig.row.order | {s: (0.0,) * rig.row.commands[s] for s in device.fail_safe}
    activated(device)

    def wires(order):
        device.read()
        device.write(order)
        return {name: rig.wire(name) for name in rig.row.rest}

    def runs():
        now = wires(released)
        return all(now[name] != rest for name, rest in rig.row.rest.items())

    for bad, signal in itertools.product(SENSELESS, device.fail_safe):
        # Of another lock or clamp nothing is wrong, so it stays open.
        safe = {s: rest for s, rest in rig.row.rest.items() if s == signal or "." not in s}
        until(runs)
        broken = released | {signal: (bad,) * rig.row.commands[signal]}
        until(lambda broken=broken, safe=safe: safe.items() <= wires(broken).items())


@each(DRIVING)
def test_switch_on_its_safe_side_stays_there_while_it_is_commanded_neither_0_nor_1(rig, device):
    kept = rig.row.order | {s: (1.0,) * rig.row.commands[s] for s in device.fail_safe}
    if rig.row.passes_on:
        kept |= rig.row.rest
    activated(device)

    def is_at_rest():
        device.read()
        device.write(kept)
        return rig.is_at_rest()

    until(is_at_rest)
    for bad in SENSELESS:
        broken = rig.row.order | {s: (bad,) * rig.row.commands[s] for s in device.fail_safe}
        for _ in range(20):
            until(lambda broken=broken: device.read() is not None and device.write(broken) is None)
            assert rig.is_at_rest(), bad
            sleep(2e-3)


@each(DRIVING)
@pytest.mark.parametrize("end", ["deactivate", "close", "exit", "bug"])
def test_every_end_leaves_the_machine_at_rest(rig, device, end):
    def work():
        with opened(device):
            rig.moves(activated(device))
            if end == "bug":
                raise KeyError("a bug")
            if end != "exit":
                getattr(device, end)()
                until(rig.is_at_rest)

    with pytest.raises(KeyError) if end == "bug" else nullcontext():
        work()
    until(rig.is_at_rest)


@each(OBEYING)
def test_neutral_stops_what_moves(rig, device):
    activated(device)
    rig.moves(device)
    device.neutral()
    signal, stands = next(iter(rig.row.rest.items()))
    if rig.row.is_held:
        signal = next(iter(rig.row.order))

        def arrived():
            """Answers come in order; the second one after all that was sent before the first."""
            for _ in range(2):
                reads(device)
            return rig.wire(signal)

        def is_still():
            before = arrived()
            sleep(0.05)
            return arrived() == before

        until(is_still)
        device.neutral()
        stands = arrived()
        sleep(0.05)
    until(lambda: rig.wire(signal) == stands)


@each(DRIVING)
def test_device_that_was_deactivated_is_activated_again(rig, device):
    activated(device)
    rig.moves(device)
    until(lambda: device.deactivate() is None)
    until(rig.is_at_rest)
    until(lambda: device.activate() is None)
    rig.moves(device)


@pytest.mark.parametrize(
    ("rig", "signal"), [("SabertoothLegs", "stop"), ("NiDaqEncoders", "voltage")], indirect=["rig"]
)
def test_emulated_device_leaves_the_wires_of_another_one_alone(rig, device, signal):
    mark = (0.25,) * rig.row.commands[signal]
    rig.set(signal, mark)
    activated(device)
    for _ in range(10):
        until(lambda: device.write(rig.row.order) is None)
        sleep(5e-3)
    assert rig.wire(signal) == mark


# Faults


def has(device, faults):
    try:
        device.read()
    except DeviceError as error:
        return error.fault in faults
    return False


@pytest.mark.parametrize(("rig", "kind"), FAULTS, indirect=["rig"])
@pytest.mark.usefixtures("own_time")
def test_faults_are_told_apart_and_the_device_comes_back(rig, device, kind):
    faults = rig.row.faults[kind]
    reads(configured(device))
    rig.begin(kind)
    until(lambda: has(device, faults))
    rig.misbehaviour.end()
    if kind == "unplugged" and rig.row.is_opened_again:
        configured(device)
    reads(device)


@pytest.mark.parametrize(
    ("rig", "kind"), [fault for fault in FAULTS if fault[1] != "garbage"], indirect=["rig"]
)
@pytest.mark.usefixtures("own_time")
def test_fault_is_told_in_time(rig, device, kind, judge):
    faults = rig.row.faults[kind]
    reads(configured(device))
    rig.begin(kind)
    until(lambda: has(device, faults))
    with judge() as judged, pytest.raises(DeviceError):
        device.read()
    judged.check(rig.row.timeout + 0.1)


@each(PROGRAMS)
@pytest.mark.usefixtures("own_time")
def test_device_is_not_configured_while_it_is_unplugged(rig, device):
    rig.begin("unplugged")
    said = []

    def refused():  # once the emulator has seen it
        try:
            device.configure()
        except DeviceError as error:
            said.append(error.fault)
        device.close()
        return said

    until(refused)
    assert said[0] in (UNPLUGGED, SILENT)
    with pytest.raises(DeviceError, match="not configured"):
        device.read()
    rig.misbehaviour.end()
    reads(configured(device))


@each(PROGRAMS)
@pytest.mark.usefixtures("own_time")
def test_close_of_an_unplugged_device_is_quiet_and_in_time(rig, device, judge):
    configured(device)
    if rig.row.order:
        activated(device)
    rig.begin("unplugged")
    sleep(0.05)
    with judge() as judged:
        device.close()
        device.close()
    judged.check(1.5)


@each([name for name in MEASURING if not ROWS[name].like])
def test_stuck_device_shows_the_same_until_it_is_well(rig, device):
    signal, values, error = rig.row.truth
    near = pytest.approx(values, abs=error)
    configured(device)
    rig.set(signal, values)
    until(lambda: device.read()[signal] == near)
    rig.begin("stuck")
    until(lambda: device.read() and rig.misbehaviour._held is not None)
    rig.set(signal, [value + 0.01 for value in values])
    for _ in range(5):
        assert reads(device)[signal] == near
    rig.misbehaviour.end()
    moved = pytest.approx([value + 0.01 for value in values], abs=error)
    until(lambda: device.read()[signal] == moved)


# Positions from one program to the next


@each(REMEMBERING)
def test_file_knows_the_positions_after_a_program_and_nothing_while_it_has_power(rig, place):
    def known():
        text = Path(place, rig.row.memory).read_text()
        return json.loads(text)[f"{rig.row.truth[0]}_m"]

    signal, values, error = rig.row.truth
    assert known() == pytest.approx(values, abs=1e-12)
    with opened(rig.device()) as first:
        until(lambda: first.read()[signal] == pytest.approx(values, abs=error))
        until(lambda: first.activate() is None)
        assert known() is None
        moved = [value + 0.005 for value in values]
        rig.set(signal, moved)
        until(lambda: first.read()[signal] == pytest.approx(moved, abs=error))
        until(lambda: first.deactivate() is None)
    assert known() == pytest.approx(moved, abs=error)
    with opened(rig.device()) as second:
        until(lambda: second.read()[signal] == pytest.approx(moved, abs=2.0 * error))


@each(REMEMBERING)
def test_positions_that_are_not_known_are_refused_without_power(rig, place):
    key = f"{rig.row.truth[0]}_at_start_mm"
    with opened(rig.device()) as killed:
        until(lambda: killed.activate() is None)  # and never deactivated
    assert rig.row.memory in refusal(rig, f"are unknown; .*, given as {key}")
    os.remove(f"{place}/{rig.row.memory}")
    refusal(rig, f"the legs' .* are unknown: .*give {key}")
    until(rig.is_at_rest)
    known = [1e3 * value for value in rig.row.truth[1]]
    with opened(rig.device(**{key: known})) as measured:
        assert measured.is_referenced


@each(REMEMBERING)
def test_reference_of_another_size_or_not_finite_is_refused(rig, device):
    configured(device)
    size = device.measures[device.position_signal]
    for values in ((0.7,) * (size - 1), (*(0.7,) * (size - 1), math.nan)):
        with pytest.raises(ValueError, match=f"{size} finite {device.position_signal}s are need"):
            device.set_reference(values)
