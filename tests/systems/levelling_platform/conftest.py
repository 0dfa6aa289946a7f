import numpy as np
import pytest

from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.systems.levelling_platform.supervisor import (
    Command,
    Phase,
    Refusal,
    Supervisor,
)
from parapod.systems.safety.faults import Severity

PERIOD, PARAMS = 0.01, PlatformDesign().supervisor
RAISED, LOW = np.full(4, PARAMS.raised), np.full(4, 0.42)
STANDING_HEIGHT = 0.390
ON_LEVEL_WHEELS = {
    "operator": 0.0,
    "drive_request": (2.0, 2.5, 2.5, 2.0),
    "posture_request": (0.0, 0.0, 0.47),
    "severity": 0.0,
    "limits": np.zeros(12),
    "extension": RAISED,
    "wheel_velocity": np.zeros(4),
    "ground": (0.02, 0.03),
    "ground_valid": 1.0,
    "foot_offsets": np.zeros(4),
    "posture_desired_state": np.zeros(6),
    "extension_desired_state": [*RAISED, 0, 0, 0, 0],
}


@pytest.fixture
def operate(stand):
    """operate(**inputs): a supervisor of a platform on level wheels, but for these inputs."""

    class Operation(stand):
        extension = RAISED

        def at(self, extension, desired=None):
            """Shows extensions, and desired ones (the same if not given)."""
            self.extension = np.array(extension, dtype=float)
            desired = self.extension if desired is None else desired
            return self.set(
                extension=self.extension, extension_desired_state=[*desired, 0, 0, 0, 0]
            )

        def touch(self, *contact):
            return self.set(limits=[*[0] * 8, *contact])

        def command(self, code):
            """The operator says something for one period."""
            return self.tick(operator=code).set(operator=0.0)

        def to(self, phase):
            """Goes to a phase by the usual way."""
            if phase is Phase.FAULT:
                self.tick(severity=Severity.HOLD).set(severity=0.0)
            elif phase is Phase.STANDBY:
                self.to(Phase.FAULT).command(Command.RESET)
            elif phase is Phase.RETRACT:
                self.to(Phase.LOWER).at(LOW).command(Command.STOP)
            elif phase is not Phase.TRANSPORT:
                self.forward_to(phase)
            assert self.phase is phase
            return self

        def forward_to(self, phase):
            """Goes from transport to a phase as soon as it can be reached."""
            self.command(Command.GO)
            for step in range(Phase.LOWER, phase + 1):
                if step == Phase.TOUCHDOWN:
                    self.at(LOW).touch(1, 1, 1, 1)
                for _ in range(1000):
                    if self.phase >= step:
                        break
                    self.tick()
            return self

        @property
        def phase(self):
            return Phase(int(self["phase"][0]))

        @property
        def refusal(self):
            why, detail = self["refusal"]
            return Refusal(int(why)), detail

    def begin(**inputs):
        system = Supervisor(DRAWN, PARAMS, STANDING_HEIGHT, PERIOD)
        return Operation(system, **(ON_LEVEL_WHEELS | inputs))

    return begin
