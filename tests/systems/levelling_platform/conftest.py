import numpy as np
import pytest

from parapod.systems.levelling_platform.model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.supervisor import (
    Command,
    Phase,
    Refusal,
    Supervisor,
    SupervisorParams,
)
from parapod.systems.safety.faults import Severity

PERIOD = 0.01
PARAMS = SupervisorParams()
STANDING_HEIGHT = 0.390
RAISED, LOW = np.full(4, PARAMS.raised), np.full(4, 0.42)


def switches(contact):
    return np.concatenate([np.zeros(8), contact])


class Operation:
    """A supervisor whose inputs are fixed by the test, period by period."""

    def __init__(self, fix, **inputs):
        self.system = Supervisor(MODEL_GEOMETRY, PARAMS, STANDING_HEIGHT, PERIOD)
        self.context = self.system.CreateDefaultContext()
        self._fix = fix
        self.extension = RAISED.copy()
        given = {
            "operator": (0.0,),
            "drive_request": (2.0, 2.5, 2.5, 2.0),
            "posture_request": (0.0, 0.0, 0.47),
            "severity": (0.0,),
            "limits": switches([0.0] * 4),
            "extension": RAISED,
            "wheel_velocity": np.zeros(4),
            "ground": (0.02, 0.03),
            "ground_valid": (1.0,),
            "foot_offsets": np.zeros(4),
            "posture_desired_state": np.zeros(6),
            "extension_desired_state": [*RAISED, 0, 0, 0, 0],
        }
        self.set(**(given | inputs))

    def set(self, **inputs):
        self._fix(self.system, self.context, **inputs)

    def at(self, extension, desired=None):
        """Shows extensions, and desired ones (the same if not given)."""
        self.extension = np.array(extension, dtype=float)
        desired = self.extension if desired is None else desired
        self.set(extension=self.extension, extension_desired_state=[*desired, 0, 0, 0, 0])

    def touch(self, *contact):
        self.set(limits=switches(contact))

    def tick(self, times=1):
        for _ in range(times):
            ahead = self.system.EvalUniquePeriodicDiscreteUpdate(self.context)
            values = [ahead.value(i).copy() for i in range(ahead.num_groups())]
            self.context.SetTime(self.context.get_time() + PERIOD)
            for i, value in enumerate(values):
                self.context.SetDiscreteState(i, value)
        return self.phase

    def wait(self, seconds):
        return self.tick(round(seconds / PERIOD))

    def command(self, code):
        """The operator says something for one period."""
        self.set(operator=(float(code),))
        self.tick()
        self.set(operator=(0.0,))
        return self.phase

    def move(self, times=1):
        """Legs that go at the rates that they are told."""
        for _ in range(times):
            self.tick()
            self.at(self.extension + PERIOD * self["leg_rate"])
        return self.phase

    def to(self, phase):
        """Goes to a phase by the usual way."""
        if phase is Phase.FAULT:
            self.set(severity=(float(Severity.HOLD),))
            self.tick()
            self.set(severity=(0.0,))
        elif phase is Phase.RETRACT:
            self.to(Phase.LOWER)
            self.at(LOW)
            self.command(Command.STOP)
        elif phase is not Phase.TRANSPORT:
            self.forward_to(phase)
        assert self.phase is phase
        return self

    def forward_to(self, phase):
        """Goes from transport to a phase as soon as it can be reached."""
        self.command(Command.GO)
        for step in range(Phase.LOWER, phase + 1):
            if step == Phase.TOUCHDOWN:
                self.at(LOW)
                self.touch(1, 1, 1, 1)
            for _ in range(1000):
                if self.phase >= step:
                    break
                self.tick()

    def __getitem__(self, name):
        return self.system.GetOutputPort(name).Eval(self.context).copy()

    @property
    def phase(self):
        return Phase(int(self["phase"][0]))

    @property
    def refusal(self):
        why, detail = self["refusal"]
        return Refusal(int(why)), detail


@pytest.fixture
def operate(fix):
    """operate(**inputs): an `Operation` of a platform on level wheels, with these inputs."""
    return lambda **inputs: Operation(fix, **inputs)
