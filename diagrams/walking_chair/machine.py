"""The walking chair, as the commands for hardware know it."""

from dataclasses import replace
from functools import partial

from parapod.diagrams.machine import Machine, Motion
from parapod.diagrams.walking_chair.closed_loop import make_closed_loop
from parapod.diagrams.walking_chair.ports import IDLE, INPUTS, OUTPUTS, TRUTH_OUTPUTS
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.walking_chair.station import make_station

SIGNALS = {
    "position_node": "m",
    "gait_time": "s",
    "support": "0/1",
    "done": "0/1",
    "payload_estimated": "kg, m, m",
    "support_margin": "m",
    "hold": "0/1",
}


def _behind_devices(scenario: ChairScenario, period: float) -> ChairScenario:
    """With drives that are motor and screw alone.

    Their controllers are among the devices: they count, and they close the velocity's loop over
    the encoder, which leaves neither an error of the gain nor an offset. The lag of that loop
    stays here, because the devices make ramps and have none.
    """
    return replace(
        scenario,
        control=replace(scenario.control, period=period),
        drives=replace(
            scenario.drives, gain_error=0.0, offset_mm_s=0.0, encoder_resolution_mm=0.0
        ),
    )


WALKING_CHAIR = Machine(
    name="the walking chair",
    experiment="chair-walk",
    scenario=ChairScenario,
    # The quasi-static plant's statics cost more than the bodies' dynamics.
    simulated={"multibody": 2e-3, "kinematic": 5e-3},
    inputs=INPUTS,
    outputs=OUTPUTS,
    truth=TRUTH_OUTPUTS,
    idle=IDLE,
    signals=SIGNALS,
    motions={
        "legs": Motion(
            command="velocity_command",
            unit="m/s",
            usual=0.01,
            largest=0.02,
            measured="position",
            measured_unit="m",
            gain=1.0,
            rest={"brake": 0.0},
        ),
    },
    make_station=make_station,
    make_closed_loop=partial(make_closed_loop, log=()),
    behind_devices=_behind_devices,
)
