"""The notebooks run from top to bottom, show what they say, and are stored without outputs."""

import ast
import copy
import importlib
import json
import multiprocessing
import re
import runpy
import tempfile
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import pytest
from jupyter_client.blocking import BlockingKernelClient
from jupyter_client.connect import write_connection_file

FOLDER = Path(__file__).parents[1] / "examples" / "notebooks"
NOTEBOOKS = {path.stem: path for path in sorted(FOLDER.glob("*.ipynb"))}
# What is true in the end, by the names of the notebook: the numbers that its text tells.
FACTS = {
    "1_level_platform": (
        "abs(lift_mm - 177) < 0.5",
        "max(roll_error_deg, pitch_error_deg) < 0.1",
        "height_error_mm < 0.2",
        "abs(ground_error_deg).max() < 0.1",
    ),
    "2_components": (
        "0.5 < settling_s < 0.65",
        "abs(np.diff(speed) - 0.01).max() < 1e-4",  # K without friction and load
        "passive_error_um < 1e-3",
        "abs(accel_noise_mg - 1.65) < 0.15",
        "abs(np.degrees(found['ground'][-1]) - [1.7, 2.8]).max() < 0.05",
        "30 < drop_mm < 45 and abs(weight_kg - 50) < 1.5",
        "bodies['truth.contact_force'][-1, [1, 3]].min() > 200",
    ),
    "3_swap_the_plant": (
        "apart_deg < 0.02 and apart_mm < 0.1",
        "sketch_tilt_deg < 1e-3",
    ),
    "4_linearize": (
        # As docs/levelling_platform.md tells.
        "abs(gain_margin_db - 35.8) < 0.05 and abs(phase_margin_deg - 89.5) < 0.05",
        "abs(slowest + 0.25) < 1e-3 and abs(time_constant_s - 4.0) < 0.02",
        "limit > 100 and max(at_limit.real) < 1e-2",
        "apart_deg < 1e-4",
        "error_deg['with'] < 0.02 < error_deg['without']",
    ),
    "5_walking_chair": (
        "abs(step_mm - 1e3 * scenario.walk.gaits[0].step) < 0.5 and tilt_deg < 0.1",
        "abs(mass_kg - 70) < 0.3 and abs(x_mm - 20) < 4 and abs(y_mm - 10) < 4",
        "peak_force < 427",
        "margin_mm > 10",
        "abs(margin_mm - 1e3 * support.margins(Passenger(70, 0.02, 0.01, 0.35)).min()) < 1",
    ),
    "6_machining_centre": (
        "500 < np.nanmin(force) < strongest < 900",
        "abs(depth_mm - 6) < 0.1 and abs(thrust - 150) < 2",
        "error_um < 50 and spare > 300",
    ),
    "7_terrain_simulator": (
        "abs(fastest - 2.67) < 0.01",
        "abs(ground_force.max() - 924) < 20 and rms_share < 0.03",
        "abs(areas[angles_deg == 0][0] - 0.1040) < 1e-4",
    ),
    "8_study": (
        "len(study) == 36 and held.sum() == 28 and refused.sum() == 8",
        "there == here",
    ),
}
DEVICES = "own_emulator("  # in the cell with emulated devices
MOST_CPU = 20.0  # of a notebook and what it starts [s]
LONGEST_OUTPUT = 40  # lines
# What all notebooks import, which is done once: their kernels are forked from one that has.
IMPORTED = (
    "ipykernel.kernelapp",
    "matplotlib.pyplot",
    "matplotlib.backends.backend_svg",
    "parapod.sims.api",
    "pydrake.multibody.plant",
    "pydrake.systems.primitives",
)
# What is computed by a notebook itself, and with what it starts [s].
OWN_CPU = "sum(getrusage(RUSAGE_SELF)[:2])"
CPU = f"{OWN_CPU} + sum(getrusage(RUSAGE_CHILDREN)[:2])"
each_notebook = pytest.mark.parametrize("name", NOTEBOOKS)


@dataclass
class Executed:
    """A notebook that has been executed.

    Attributes:
        facts: by expression what it gave in the end.
        outputs: content of all messages for the page, by type.
    """

    facts: dict = field(default_factory=dict)
    outputs: dict = field(default_factory=dict)

    def texts(self):
        """Printed texts, and those of results."""
        yield from (content["text"] for content in self.outputs.get("stream", ()))
        for content in self.shown():
            yield content.get("text/plain", "")

    def shown(self):
        """Data of displays and results, by type."""
        for kind in ("display_data", "execute_result"):
            yield from (content["data"] for content in self.outputs.get(kind, ()))


@pytest.fixture(scope="module")
def cleared():
    """cleared(notebook): what is stored of it."""
    return runpy.run_path(str(FOLDER / "clear.py"))["cleared"]


@pytest.fixture(scope="module")
def forks():
    """The process from which kernels are forked."""
    with pytest.MonkeyPatch.context() as patch:
        # As a kernel has it, which for Matplotlib is too late when it is there already.
        patch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(list(IMPORTED))
        yield context


@pytest.fixture
def kernel(forks, tmp_path):
    """A fresh kernel in the notebooks' folder."""
    from ipykernel.kernelapp import launch_new_instance

    # The path of a socket must be short.
    with tempfile.TemporaryDirectory(prefix="pp") as folder:
        path, _ = write_connection_file(f"{folder}/kernel.json", ip=f"{folder}/k", transport="ipc")
        argv = [
            "-f",
            path,
            f"--IPKernelApp.ipython_dir={tmp_path}",
            "--HistoryManager.enabled=False",
        ]
        process = forks.Process(target=launch_new_instance, args=(argv,), daemon=True)
        process.start()
        client = BlockingKernelClient(connection_file=path)
        client.load_connection_file()
        client.start_channels()
        try:
            client.wait_for_ready(timeout=300)
            run(client, f"%cd -q {FOLDER}")
            yield client
        finally:
            client.shutdown()
            process.join(10)
            process.kill()
            client.stop_channels()


def run(client, code, outputs=None, **expressions):
    """Runs a cell; the values of the expressions after it."""

    def note(message):
        if outputs is not None:
            outputs.setdefault(message["msg_type"], []).append(message["content"])

    reply = client.execute_interactive(
        code, output_hook=note, user_expressions=expressions, timeout=600, stop_on_error=True
    )["content"]
    if reply["status"] != "ok":
        trace = re.sub(r"\x1b\[[\d;]*m", "", "\n".join(reply.get("traceback", ())))
        pytest.fail(f"{code}\n\n{trace}", pytrace=False)
    return {
        name: value["data"]["text/plain"] if value["status"] == "ok" else value["evalue"]
        for name, value in reply["user_expressions"].items()
    }


def check(found, facts, cpu="cpu"):
    """Whether facts are so, and nothing is said or computed that a reader would not want."""
    for fact in facts:
        assert found.facts[fact] in ("True", "np.True_"), f"{fact}: {found.facts[fact]}"
    assert "error" not in found.outputs
    for text in found.texts():
        assert len(text.splitlines()) <= LONGEST_OUTPUT, text
    said = [each["text"] for each in found.outputs.get("stream", ()) if each["name"] == "stderr"]
    assert not said
    assert any({"image/png", "image/svg+xml"} & set(data) for data in found.shown())
    if float(found.facts[cpu]) > MOST_CPU:  # which depends on the processor
        pytest.skip(f"all holds, after {found.facts[cpu]} s of CPU where {MOST_CPU} are meant")


def execute(client, name, without=None):
    """All cells of a notebook but those with a text, then its facts."""
    found = Executed()
    for cell in read(name)["cells"]:
        code = "".join(cell["source"])
        if cell["cell_type"] == "code" and not (without and without in code):
            run(client, code, found.outputs)
    wanted = {f"fact_{i}": fact for i, fact in enumerate(FACTS[name])}
    wanted |= {"cpu": CPU, "own_cpu": OWN_CPU}
    values = run(client, "from resource import *", **wanted)
    found.facts = values | {fact: values[key] for key, fact in wanted.items()}
    return found


def read(name):
    return json.loads(NOTEBOOKS[name].read_text())


@each_notebook
def test_a_notebook_runs_and_shows_what_it_says(kernel, name):
    found = execute(kernel, name, without=DEVICES)  # which need a clock
    scenes = [data for data in found.shown() if "srcdoc=" in data.get("text/html", "")]
    assert len(scenes) == NOTEBOOKS[name].read_text().count("parapod.Scene.from_meshcat(")
    check(found, FACTS[name])


@pytest.mark.slow
def test_emulated_devices_of_a_notebook_hold_their_bounds_and_end(kernel):
    (name,) = [name for name in NOTEBOOKS if DEVICES in NOTEBOOKS[name].read_text()]
    found = execute(kernel, name)
    assert not [text for text in found.texts() if text.startswith("left out:")]
    after = run(kernel, "import os", passed="result.passed", left="os.environ")
    assert after["passed"] == "True"
    assert "PARAPOD_EMULATOR" not in after["left"]
    # An emulator goes on computing while it waits for a busy computer.
    check(found, FACTS[name], cpu="own_cpu")


@pytest.mark.slow
def test_emulated_devices_are_left_out_without_their_libraries(kernel, tmp_path):
    (name,) = [name for name in NOTEBOOKS if DEVICES in NOTEBOOKS[name].read_text()]
    for library in ("nidaqmx", "grpc"):
        (tmp_path / f"{library}.py").write_text("raise ImportError('it is not here')")
    # For the kernel, and for the emulator that it begins.
    run(kernel, f"import os, sys; sys.path.insert(0, {str(tmp_path)!r})")
    run(kernel, f"os.environ['PYTHONPATH'] = {str(tmp_path)!r}")
    found = execute(kernel, name)
    check(found, FACTS[name])
    (reason,) = [text for text in found.texts() if text.startswith("left out:")]
    assert 'pip install "parapod[ni]"' in reason


@each_notebook
def test_a_notebook_is_stored_without_outputs_and_without_its_machine(name, cleared):
    notebook = read(name)
    assert set(notebook["metadata"]["language_info"]) == {"name"}
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    ids = [cell["id"] for cell in notebook["cells"]]
    assert len(set(ids)) == len(ids)
    for cell in notebook["cells"]:
        assert not any((cell["metadata"], cell.get("outputs"), cell.get("execution_count")))
    # As Jupyter writes it: a change of one line is one line of a difference.
    assert NOTEBOOKS[name].read_text() == cleared(notebook), "run examples/notebooks/clear.py"


def test_what_running_leaves_is_cleared(cleared):
    stored = read("8_study")
    used = copy.deepcopy(stored)
    used["metadata"] |= {"widgets": {}, "language_info": {"name": "python", "version": "3.99"}}
    for number, cell in enumerate(used["cells"]):
        cell["metadata"] = {"execution": {"iopub.status.busy": "2026"}}
        if cell["cell_type"] == "code":
            cell |= {"execution_count": number, "outputs": [{"output_type": "stream"}]}
    assert json.loads(cleared(used)) == stored


@each_notebook
def test_links_of_a_notebook_lead_somewhere(name):
    texts = ["".join(c["source"]) for c in read(name)["cells"] if c["cell_type"] == "markdown"]
    links = [link for text in texts for link in re.findall(r"\]\(([^)]+)\)", text)]
    assert links
    for link in links:
        page, _, heading = link.partition("#")
        assert (FOLDER / page).is_file(), link
        headings = re.findall(r"^#+ (.*)", (FOLDER / page).read_text(), re.MULTILINE)
        assert not heading or heading in [text.lower().replace(" ", "-") for text in headings]


def test_each_notebook_has_its_facts_and_leads_to_the_next():
    assert set(NOTEBOOKS) == set(FACTS)
    names = list(NOTEBOOKS)
    for name, after in pairwise(names):
        assert f"]({after}.ipynb)" in NOTEBOOKS[name].read_text()


@each_notebook
def test_a_notebook_names_what_is_there_and_public(name):
    code = ["".join(c["source"]) for c in read(name)["cells"] if c["cell_type"] == "code"]
    named = set()
    for node in (node for text in code for node in ast.walk(ast.parse(text))):
        if isinstance(node, ast.ImportFrom):
            named |= {(node.module, alias.name) for alias in node.names}
        elif isinstance(node, ast.Attribute) and ast.unparse(node.value) == "parapod":
            named.add(("parapod", node.attr))
    assert ("parapod", "scenario") in named
    for module, attribute in named:
        assert hasattr(importlib.import_module(module), attribute), f"{module}.{attribute}"
        assert not attribute.startswith("_")
        assert not any(part.startswith("_") for part in module.split("."))
