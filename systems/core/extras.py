"""Libraries that only some users of parapod need: imported where they are used, by `need`."""

import importlib
from types import ModuleType

from parapod.systems.core.errors import MissingExtra

# The extra of `pip install "parapod[extra]"` that brings each module.
EXTRAS = {
    "av": "video",
    "builtin_interfaces": "ros2",
    "can": "can",
    "canopen": "can",
    "distributed": "cluster",
    "geometry_msgs": "ros2",
    "google.protobuf": "ni",
    "grpc": "ni",
    "iio": "iio",
    "mcap": "log",
    "mujoco": "mujoco",
    "nidaqmx": "ni",
    "plotly": "replay",
    "pyarrow": "study",
    "pygraphviz": "draw",
    "pymoo": "design",
    "pysoem": "ethercat",
    "rclpy": "ros2",
    "rosbags": "log",
    "rosgraph_msgs": "ros2",
    "sensor_msgs": "ros2",
    "serial": "serial",
    "spidev": "spi",
    "std_msgs": "ros2",
    "visualization_msgs": "ros2",
}


def need(module: str) -> ModuleType:
    """A module of an optional library.

    Args:
        module: its dotted name.

    Raises:
        MissingExtra: it is not installed, or a library of the system that it needs is not.
    """
    try:
        return importlib.import_module(module)
    # ctypes, given the name of a library that is not there, looks in the program itself and misses
    # the first symbol: an AttributeError.
    except (ImportError, OSError, AttributeError) as error:
        extra = max((name for name in EXTRAS if f"{module}.".startswith(f"{name}.")), key=len)
        raise MissingExtra(extra, EXTRAS[extra], str(error)) from error
