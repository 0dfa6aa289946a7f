"""Optional libraries: imported when they are needed, named when they are missing."""

import sys
import tomllib
from pathlib import Path

import pytest

from parapod.systems.core.errors import MissingExtra, ParapodError
from parapod.systems.core.extras import EXTRAS, need

NO_DEVICES = {
    "av",
    "builtin_interfaces",
    "distributed",
    "geometry_msgs",
    "mujoco",
    "plotly",
    "pyarrow",
    "pygraphviz",
    "pymoo",
    "rclpy",
    "rosgraph_msgs",
    "sensor_msgs",
    "std_msgs",
    "visualization_msgs",
}
PROJECT = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]


@pytest.fixture
def block(monkeypatch):
    """Makes a module as if it were not installed."""

    def hide(module):
        monkeypatch.setitem(sys.modules, module, None)

    return hide


@pytest.mark.parametrize("module", sorted(EXTRAS))
def test_every_optional_module_has_an_extra_of_the_package(module):
    extras = PROJECT["optional-dependencies"]
    assert EXTRAS[module] in extras
    (everything,) = extras["hardware"]
    is_of_hardware = EXTRAS[module] in everything.partition("[")[2].rstrip("]").split(",")
    assert is_of_hardware == (module not in NO_DEVICES)


def test_tests_need_all_of_them_but_the_one_that_has_to_be_compiled():
    extras = PROJECT["optional-dependencies"]
    (ours,) = [name for name in extras["test"] if name.startswith("parapod[")]
    names = ours.removeprefix("parapod[").rstrip("]").split(",")
    assert set(names) == set(EXTRAS.values()) - {"spi"}


def test_none_of_them_is_needed_by_the_package_itself():
    needed = {name.partition(">")[0].partition("=")[0] for name in PROJECT["dependencies"]}
    assert not needed & {*EXTRAS, *EXTRAS.values(), "python-can", "pyserial", "grpcio"}


def test_a_module_that_is_there_is_returned(monkeypatch):
    made = object()
    monkeypatch.setitem(sys.modules, "serial", made)
    assert need("serial") is made


@pytest.mark.parametrize(("module", "extra"), sorted(EXTRAS.items()))
def test_a_module_that_is_missing_is_named_with_the_command_that_installs_it(block, module, extra):
    block(module)
    with pytest.raises(MissingExtra) as caught:
        need(module)
    assert (caught.value.module, caught.value.extra) == (module, extra)
    text = str(caught.value)
    assert text.startswith(f"{module} is needed and cannot be imported: ")
    assert text.endswith(f'; install it with: pip install "parapod[{extra}]"')
    assert "\n" not in text
    assert isinstance(caught.value, ParapodError)
    assert isinstance(caught.value.__cause__, ImportError)


def test_a_part_of_a_module_is_named_by_its_package(block):
    block("nidaqmx")
    with pytest.raises(MissingExtra, match=r"^nidaqmx is needed .*parapod\[ni\]") as caught:
        need("nidaqmx.nothing.of_this_name")
    assert caught.value.module == "nidaqmx"


def test_a_library_of_the_system_that_is_missing_is_told(tmp_path, monkeypatch):
    (tmp_path / "spidev.py").write_text("raise OSError('libspi.so.1:\\n cannot open')\n")
    monkeypatch.delitem(sys.modules, "spidev", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(MissingExtra, match=r"imported: libspi\.so\.1: cannot open; install"):
        need("spidev")
    sys.modules.pop("spidev", None)


def test_a_library_of_the_system_that_ctypes_does_not_find_is_told(tmp_path, monkeypatch):
    code = "import ctypes\nctypes.CDLL(None).iio_get_backends_count\n"
    (tmp_path / "iio.py").write_text(code)
    monkeypatch.delitem(sys.modules, "iio", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(MissingExtra, match=r"undefined symbol: iio_get_backends_count; install"):
        need("iio")
    sys.modules.pop("iio", None)


def test_a_module_that_is_broken_is_not_called_missing(tmp_path, monkeypatch):
    (tmp_path / "spidev.py").write_text("1 / 0\n")
    monkeypatch.delitem(sys.modules, "spidev", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ZeroDivisionError):
        need("spidev")
