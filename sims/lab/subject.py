"""The machine that a log is of, as far as this parapod knows it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

from parapod.diagrams.drivers.external import load_installed_drivers
from parapod.diagrams.machine import Machine
from parapod.diagrams.plots import Limits
from parapod.sims.lab.discovery import find_experiment
from parapod.sims.lab.experiment import Experiment
from parapod.sims.output.drawn import DrawnLog, LogDrawing
from parapod.sims.output.logs.mcap import Message, Picture
from parapod.sims.output.logs.scene_messages import scene_messages
from parapod.sims.output.logs.stored import WALL_CLOCKS
from parapod.sims.output.moment import moment
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.quoting import printable
from parapod.systems.core.scenario_file import parse, read_scenario


@dataclass
class Subject:
    """Experiment and machine of a log.

    Attributes:
        label: name of the log in sentences.
        shapes: shape of one sample of each signal, by port name.
        metadata: data about the run.
        experiment: the experiment; None where the log names none that is installed.
        scenario: its scenario, or the machine's; None where it is not admissible here.
        machine: the machine in that scenario, or None.
        drawn: drawing of the machine; None: it is not drawn.
        undrawn: reason for that.
        remarks: sentences on what differs from what a log of this parapod has.
    """

    label: str
    shapes: Mapping[str, tuple[int, ...]]
    metadata: Mapping[str, Any]
    experiment: Experiment[Any, Any] | None = None
    scenario: Any = None
    machine: Machine[Any] | None = None
    drawn: DrawnLog | None = None
    undrawn: str = ""
    remarks: list[str] = field(default_factory=list)

    @classmethod
    def from_metadata(
        cls,
        label: str,
        shapes: Mapping[str, tuple[int, ...]],
        metadata: Mapping[str, Any],
        is_drawn: bool = True,
    ) -> "Subject":
        """Finds out what a log is of; missing things are reported.

        Args:
            label: name of the log in sentences.
            shapes: shape of one sample of each signal, by port name.
            metadata: data about the run.
            is_drawn: true if the machine is to be drawn.
        """
        subject = cls(label, shapes, metadata)
        try:
            subject._find()
        except ParapodError as error:
            subject.undrawn = str(error)
        if not is_drawn:
            subject.drawn, subject.undrawn = None, "no drawing was asked for"
        elif subject.undrawn:
            subject.give_up(subject.undrawn)
        return subject

    def give_up(self, reason: str) -> None:
        """Has the machine not drawn, for a reason that is reported."""
        self.drawn, self.undrawn = None, reason
        self.remarks.append(f"{self.label}: the machine is not drawn: {reason}")

    @property
    def name(self) -> str:
        """Name of the experiment, from the log."""
        return printable(self.metadata.get("experiment", "")) or "unknown experiment"

    @property
    def title(self) -> str:
        """Experiment and machine."""
        return f"{self.name}: {self.machine.title}" if self.machine is not None else self.name

    @property
    def plots(self) -> Sequence[str]:
        """Usual plots: of the experiment, or of its machine where the log has none of those.

        On a real machine an experiment leaves the log of its job.
        """
        own = () if self._drawing is None else self._drawing.plots
        names = {each.partition("[")[0] for text in own for each in text.split("+")}
        if names & self.shapes.keys():
            return own
        return () if self.machine is None else self.machine.plots

    @property
    def _drawing(self) -> LogDrawing | None:
        return None if self.experiment is None else self.experiment.drawing

    @property
    def phase(self) -> tuple[str, tuple[str, ...]] | None:
        """The first signal that shows phases, and their names."""
        table = {} if self.machine is None else self.machine.table
        for name in self.shapes:
            if name in table and table[name].names:
                return name, table[name].names
        return None

    @property
    def limits(self) -> Limits:
        """Smallest and largest admissible value of signals."""
        if self.experiment is None or not isinstance(self.scenario, self.experiment.schema):
            return {}
        try:
            return self.experiment.limits(self.scenario)
        except ParapodError:  # of files that are not here, which the drawing tells about
            return {}

    @property
    def facts(self) -> Iterator[str]:
        """Origin of the log, in a few words each."""
        settings = self.scenario
        if settings is not None:
            yield f"backend {settings.backend}"
            yield f"seed {settings.seed}"
        entry = self.metadata.get("parapod")
        if entry:
            yield f"parapod {printable(entry)}"
        began = self.metadata.get("wall_time", 0.0)
        if began > WALL_CLOCKS:
            yield moment(began)
        elif written := self.metadata.get("written"):
            yield printable(written)

    def machine_scenario(self) -> Any:
        """The machine's part of the scenario."""
        experiment: Any = self.experiment
        if isinstance(self.scenario, experiment.schema):
            return experiment.machine_scenario(self.scenario)
        return self.scenario

    def _find(self) -> None:
        metadata, here = self.metadata, version("parapod")
        if "experiment" not in metadata:
            self.undrawn = "the log does not show its experiment"
            return
        entry_name = str(metadata.get("parapod", ""))
        if entry_name != here:
            self.remarks.append(
                f"{self.label} was written by parapod {printable(entry_name) or 'unknown'}, "
                f"this is {here}"
            )
        self.experiment = find_experiment(str(metadata["experiment"]))
        machine = self.experiment.drawn_machine()
        self.machine = machine
        self.scenario = self._read_scenario(machine)
        self.machine = machine.for_scenario(self.machine_scenario())
        settings = self.machine_scenario()
        self.drawn = DrawnLog.from_shapes(self.machine, settings, self._drawing, self.shapes)

    def _read_scenario(self, machine: Machine[Any]) -> Any:
        """The scenario; of hardware's drivers, which need not be known here, nothing is needed.

        Raises:
            ScenarioError: it is admissible neither for the experiment nor for its machine.
        """
        assert self.experiment is not None
        load_installed_drivers()
        source = f"the scenario in {self.label}"
        data = parse(str(self.metadata.get("scenario", "")), source) or {}
        if isinstance(data, dict):
            data = {key: value for key, value in data.items() if key != "hardware"}
            if isinstance(data.get("machine"), dict):
                data["machine"] = {k: v for k, v in data["machine"].items() if k != "hardware"}
        try:
            return read_scenario(self.experiment.schema, data, source)
        except ScenarioError:
            if machine.scenario is self.experiment.schema:
                raise
            return read_scenario(machine.scenario, data, source)


def draw_log(
    metadata: Mapping[str, Any],
    shapes: Mapping[str, tuple[int, ...]],
    pictures: Sequence[Picture],
) -> Iterator[Message]:
    """Draws the machine of a log into it.

    Args:
        metadata: data about the run.
        shapes: shape of one sample of each signal, by port name.
        pictures: stamp [ns], time [s] and samples of the signals.

    Raises:
        ParapodError: the machine cannot be drawn.
    """
    subject = Subject.from_metadata("log", shapes, metadata)
    if subject.drawn is None:
        raise ParapodError(subject.undrawn)
    return scene_messages(subject.drawn, pictures)
