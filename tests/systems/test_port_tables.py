import ast
import importlib
import inspect
import pkgutil
import re
from pathlib import Path

import pytest
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder, LeafSystem, LeafSystem_, PortDataType
from pydrake.systems.scalar_conversion import TemplateSystem

import parapod.systems
from parapod.diagrams.levelling_platform.model import add_platform
from parapod.diagrams.walking_chair.model import add_chair
from parapod.systems.levelling_platform.wheels import WHEEL_DRIVE

ROOT = Path(__file__).parents[2]
ROW = re.compile(r"^\s*\| (in|out) `([a-z_0-9]+)` \|([^|]*)\|([^|]*)\|([^|]*)\|\s*$")
NEED_A_MODEL = {"PlatformTruth", "FootTruth", "PlatformPose"}
NEED_A_CHAIR = {"ChairTruth", "ChairPose"}
NEED_MESHCAT = {"OperatorControls", "PostureSliders"}
ARGUMENTS = {
    "InertialMotion": {"state_size": 13, "pose_start": 0, "velocity_start": 7, "period": 0.01},
    "ServoGoal": {"params": WHEEL_DRIVE, "channels": 4},
}


def modules():
    found = pkgutil.walk_packages(parapod.systems.__path__, "parapod.systems.")
    return [importlib.import_module(info.name) for info in found]


def public_leaf_systems():
    """Classes that a module of `parapod.systems` defines, templates by their default form."""
    found = {}
    for module in modules():
        for name, value in vars(module).items():
            if name.startswith("_"):
                continue
            if isinstance(value, TemplateSystem):
                if getattr(module, name.rstrip("_"), None) is not None:
                    found[name.rstrip("_")] = value[None]
            elif (
                inspect.isclass(value)
                and issubclass(value, LeafSystem)
                and value.__module__ == module.__name__
                and name != "Impl"
            ):
                found[name] = value
    # A base class declares parameters, not ports.
    found.pop("OnInclinedGround", None)
    # Its ports are its arguments.
    found.pop("FunctionSystem", None)
    return found


SYSTEMS = public_leaf_systems()


@pytest.fixture(scope="module")
def model():
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 1e-3)
    return add_platform(plant), builder.Build()


@pytest.fixture(scope="module")
def chair():
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 1e-3)
    return add_chair(plant), builder.Build()


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


@pytest.fixture
def system(name, request):
    """The system of that name with default arguments."""
    if name in NEED_A_MODEL:
        platform, _ = request.getfixturevalue("model")  # with the diagram that keeps it alive
        return SYSTEMS[name](platform)
    if name in NEED_A_CHAIR:
        model, _ = request.getfixturevalue("chair")
        return SYSTEMS[name](model)
    if name == "ParallelLinks":
        platform, _ = request.getfixturevalue("model")
        return SYSTEMS[name](platform, SceneGraph(), platform.plant.num_positions())
    if name in NEED_MESHCAT:
        return SYSTEMS[name](request.getfixturevalue("meshcat"))
    return SYSTEMS[name](**ARGUMENTS.get(name, {}))


def table_of(name):
    text = inspect.getdoc(SYSTEMS[name]) or ""
    rows = [match.groups() for match in map(ROW.match, text.splitlines()) if match]
    return [tuple(cell.strip() for cell in row) for row in rows]


def declared(system):
    """(direction, name, size or None) of the ports, inputs first."""
    ports = [("in", system.get_input_port(i)) for i in range(system.num_input_ports())]
    ports += [("out", system.get_output_port(i)) for i in range(system.num_output_ports())]
    return [
        (
            direction,
            port.get_name(),
            port.size() if port.get_data_type() == PortDataType.kVectorValued else None,
        )
        for direction, port in ports
    ]


def test_the_systems_are_found():
    assert {"KinematicFeedforward", "LinearActuator", "Imu", "PlatformTruth"} <= set(SYSTEMS)
    assert len(SYSTEMS) >= 18
    assert all(issubclass(system, (LeafSystem, LeafSystem_[None])) for system in SYSTEMS.values())


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_port_table_lists_the_declared_ports_in_order(name, system):
    ports = declared(system)
    table = table_of(name)
    for direction in ("in", "out"):
        listed = [row[1] for row in table if row[0] == direction]
        assert listed == [port for side, port, _ in ports if side == direction]


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_sizes_in_the_port_table_are_those_declared(name, system):
    sizes = {(side, port): size for side, port, size in declared(system)}
    for direction, port, size, _, _ in table_of(name):
        if sizes[direction, port] is None:
            assert size == "abstract"
        elif re.fullmatch(r"\d*n", size) is None:
            assert int(size) == sizes[direction, port]


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_rows_of_the_port_table_have_unit_and_meaning(name):
    for _, _, _, unit, meaning in table_of(name):
        assert unit
        assert len(meaning) > 3


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_table_has_a_heading_and_no_row_is_malformed(name):
    lines = [line.strip() for line in (inspect.getdoc(SYSTEMS[name]) or "").splitlines()]
    rows = [line for line in lines if line.startswith("|")]
    assert rows[:2] == ["| port | size | unit | meaning |", "|---|---|---|---|"]
    assert len(rows) - 2 == len(table_of(name))


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_docstring_tells_state_or_bad_input(name):
    text = inspect.getdoc(SYSTEMS[name]) or ""
    assert re.search(r"\b(Bad input|[Ss]tate)\b", text)


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_docstring_begins_with_one_line(name):
    text = inspect.getdoc(SYSTEMS[name]) or ""
    first, second = text.splitlines()[:2]
    assert first.endswith(".")
    assert not second.strip()


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_systems_and_their_ports_have_names_in_snake_case(name, system):
    snake = re.compile(r"[a-z][a-z0-9_]*")
    assert snake.fullmatch(system.get_name())
    for _, port, _ in declared(system):
        assert snake.fullmatch(port)


# Who may import whom


def sources(*rooms):
    return [path for room in rooms for path in sorted((ROOT / room).rglob("*.py"))]


def imported(path):
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def imports_any(path, *prefixes):
    return [
        name
        for name in imported(path)
        if any(name == prefix or name.startswith(f"{prefix}.") for prefix in prefixes)
    ]


def test_sources_are_found():
    assert len(sources("systems")) > 20
    assert len(sources("diagrams")) > 5


@pytest.mark.parametrize("path", sources("systems"), ids=lambda path: path.stem)
def test_systems_import_neither_diagrams_nor_sims(path):
    assert imports_any(path, "parapod.diagrams", "parapod.sims") == []


@pytest.mark.parametrize("path", sources("diagrams", "urdf"), ids=lambda path: path.stem)
def test_diagrams_do_not_import_sims(path):
    assert imports_any(path, "parapod.sims") == []


@pytest.mark.parametrize(
    "path",
    sources("systems", "diagrams", "sims", "urdf", "benchmarks", "tests"),
    ids=lambda path: path.stem,
)
def test_nothing_imports_pydrake_all_or_a_bare_room(path):
    assert imports_any(path, "pydrake.all", "systems", "diagrams", "sims", "urdf") == []
