"""Commands that a person gives in the browser: postures, and the whole operation."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from math import ceil, degrees, floor, isfinite, radians
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import Context

from parapod.systems.arm.serial_arm import ArmJoint
from parapod.systems.core.controls import Controls, Slider, shown
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import elements, has_value, is_on, read_array, read_or_zeros
from parapod.systems.levelling_platform.carried_arm import CarriedArm
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import height_range
from parapod.systems.levelling_platform.statics import PAPER_ARM
from parapod.systems.levelling_platform.supervisor import Command

# Longest silence that is reported [s].
_LONGEST = 1e3


@dataclass(frozen=True)
class PostureSlidersParams:
    """Range of the sliders where the ground is not known: a little more than on level ground.

    Defaults are the paper's platform's.

    Attributes:
        angle: largest roll and pitch to either side [rad].
        height_min: smallest height [m].
        height_max: largest height [m].
        angle_step: step of the sliders of roll and pitch [rad].
        height_step: step of the slider of the height [m].
    """

    angle: float = radians(10.0)
    height_min: float = 0.39
    height_max: float = 0.57
    angle_step: float = radians(0.1)
    height_step: float = 0.001

    @classmethod
    def for_geometry(cls, geometry: PlatformGeometry) -> "PostureSlidersParams":
        """Ranges of a platform: whole centimetres and degrees around all that it can take."""
        level = (0.0, 0.0)
        low, high = height_range(geometry, level, level).tolist()
        angles = np.radians(np.arange(1.0, 90.0))
        turns = np.zeros((2, len(angles), 2))
        turns[0, :, 0] = turns[1, :, 1] = angles
        lowest, highest = np.moveaxis(height_range(geometry, turns, level), -1, 0)
        count = int((lowest <= highest).sum(axis=1).max())
        return cls(
            angle=radians(count + 1.0),
            height_min=floor(100.0 * low) / 100.0,
            height_max=ceil(100.0 * high) / 100.0,
        )

    @property
    def angles(self) -> NDArray[np.float64]:
        """Values of the sliders of roll and pitch [rad]."""
        count = round(self.angle / self.angle_step)
        return np.linspace(-count, count, 2 * count + 1) * self.angle_step


def posture_ranges(
    geometry: PlatformGeometry,
    posture: ArrayLike,
    ground: ArrayLike,
    foot_offsets: ArrayLike = (0.0, 0.0, 0.0, 0.0),
    params: PostureSlidersParams = PostureSlidersParams(),
) -> NDArray[np.float64] | None:
    """Range of each element of a posture while the others stay.

    Args:
        geometry: the platform.
        posture: (3) roll, pitch, height [rad, rad, m].
        ground: (2) roll and pitch of the ground [rad].
        foot_offsets: (4) how far each foot stands above the ground's plane [m].
        params: steps and largest angles.

    Returns:
        (3, 2) smallest and largest values, whole steps; None where the legs do not reach the
        posture itself.
    """
    roll, pitch, height = np.asarray(posture, dtype=float)
    low, high = height_range(geometry, (roll, pitch), ground, foot_offsets)
    if not low <= height <= high:
        return None
    ranges = []
    for axis, present in enumerate((roll, pitch)):
        attitudes = np.tile([roll, pitch], (len(params.angles), 1))
        attitudes[:, axis] = params.angles
        lowest, highest = height_range(geometry, attitudes, ground, foot_offsets).T
        misses = np.flatnonzero((height < lowest) | (height > highest))
        values = params.angles
        below, above = misses[values[misses] < present], misses[values[misses] > present]
        first = below[-1] + 1 if below.size else 0
        last = above[0] - 1 if above.size else len(values) - 1
        ranges.append((min(values[first], present), max(values[last], present)))
    step = params.height_step
    lowest, highest = step * np.ceil(low / step), step * np.floor(high / step)
    ranges.append((min(lowest, height), max(highest, height)))
    return np.array(ranges)


class _PostureControls(LeafSystem):
    """Three sliders that show a posture, and go no further than it can be reached."""

    ROLL, PITCH, HEIGHT = "roll [deg]", "pitch [deg]", "height [mm]"

    def __init__(
        self,
        controls: Controls,
        height: float = 0.477,
        geometry: PlatformGeometry = PlatformGeometry(),
        params: PostureSlidersParams | None = None,
        period: float = 0.05,
    ):
        """Creates the source; shows nothing yet.

        Args:
            controls: owner of sliders and buttons: a `Meshcat`, or one with its methods.
            height: height of the level posture [m].
            geometry: the platform.
            params: ranges of the posture's sliders; None: those for the geometry.
            period: period of reading the controls [s].
        """
        super().__init__()
        self._controls, self._geometry = controls, geometry
        self._params = params or PostureSlidersParams.for_geometry(geometry)
        self._level = np.array([0.0, 0.0, height])
        self._fitted: list[float] = []
        self._ground = self.DeclareVectorInputPort("ground_estimated", 2)
        self._offsets = self.DeclareVectorInputPort("foot_offsets_estimated", LEG_COUNT)
        self._valid = self.DeclareVectorInputPort("ground_valid", 1)
        self._declare()
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _declare(self) -> None:
        """Declares the outputs and their state."""
        raise NotImplementedError(f"{type(self).__name__} does not define _declare")

    def _update(self, context: Context, discrete_state: Any) -> None:
        """Reads the controls."""
        raise NotImplementedError(f"{type(self).__name__} does not define _update")

    def _sliders(self) -> list[Slider]:
        """The sliders, of whose ranges nothing is known yet."""
        limits = self._params
        angle, step = degrees(limits.angle), degrees(limits.angle_step)
        heights = 1e3 * np.array([limits.height_min, limits.height_max, limits.height_step])
        self._fitted = []
        return [
            (self.ROLL, -angle, angle, step, degrees(self._level[0])),
            (self.PITCH, -angle, angle, step, degrees(self._level[1])),
            (self.HEIGHT, *heights.tolist(), 1e3 * self._level[2]),
        ]

    def _read_posture(self) -> NDArray[np.float64] | None:
        """The sliders' posture (3) [rad, rad, m]; None while they are not shown."""
        if self.HEIGHT not in self._controls.GetSliderNames():
            return None
        roll, pitch, height = (
            self._controls.GetSliderValue(name) for name in (self.ROLL, self.PITCH, self.HEIGHT)
        )
        return np.array([radians(roll), radians(pitch), 1e-3 * height])

    def _fit(self, context: Context, posture: NDArray[np.float64]) -> None:
        """Lets each slider go as far as the legs reach while the others stay."""
        set_range = getattr(self._controls, "SetSliderRange", None)
        has_ground = has_value(self._valid, context) and is_on(self._valid, context)
        if set_range is None or not has_ground:
            return
        ground = read_array(self._ground, context)
        offsets = np.array(read_or_zeros(self._offsets, context))
        values = [*posture, *ground, *offsets]
        if values == self._fitted or not np.isfinite(values).all():
            return
        self._fitted = values
        ranges = posture_ranges(self._geometry, posture, ground, offsets, self._params)
        if ranges is None:
            return
        display = np.array([np.degrees(ranges[0]), np.degrees(ranges[1]), 1e3 * ranges[2]])
        for name, limits in zip((self.ROLL, self.PITCH, self.HEIGHT), display, strict=True):
            set_range(name, *np.round(limits, 6).tolist())


class PostureSliders(_PostureControls):
    """Commands the posture that three sliders show.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `ground_estimated` | 2 | rad | estimated roll and pitch of the ground |
    | in `foot_offsets_estimated` | 4 | m | heights under the feet; unconnected: 0 |
    | in `ground_valid` | 1 | - | above 0.5: sliders end where legs do; unconnected: never |
    | out `posture_command` | 3 | rad, rad, m | commanded roll, pitch, height; jumps |

    The sliders exist while `shown` is entered, and start at the level posture. Controls with
    fixed ranges let a person ask for what cannot be reached; that is left to `PostureReference`
    with `on_unreachable="clamp"`.

    State: discrete, the command (3), read from the sliders every period.

    Bad input: while there are no sliders the last command stays; on a ground that is not finite
    the sliders' ranges stay.
    """

    def _declare(self) -> None:
        self.set_name("posture_sliders")
        self.DeclareStateOutputPort("posture_command", self.DeclareDiscreteState(self._level))

    def shown(self) -> AbstractContextManager[None]:
        """Shows the sliders, and takes them away at the end."""
        return shown(self._controls, self._sliders())

    def _update(self, context: Context, discrete_state: Any) -> None:
        command = self._read_posture()
        if command is not None:
            discrete_state.set_value(command)
            self._fit(context, command)


class OperatorControls(_PostureControls):
    """The operator of the whole platform, who has buttons and sliders.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `ground_estimated` | 2 | rad | estimated roll and pitch of the ground |
    | in `foot_offsets_estimated` | 4 | m | heights under the feet; unconnected: 0 |
    | in `ground_valid` | 1 | - | above 0.5: sliders end where legs do; unconnected: never |
    | out `operator` | 1 | - | a `Command`, for a moment after its button was clicked |
    | out `drive_request` | 2 | m/s, rad/s | forward speed and yaw rate |
    | out `posture_request` | 3 | rad, rad, m | posture to take |
    | out `jog_request` | 4 | m/s | rates of single legs |
    | out `operator_age` | 1 | s | since the person was heard; 0 for controls that cannot tell |
    | out `arm_request` | n | rad or m | positions of the arm's joints, if it has any |

    Sliders and buttons exist while `shown` is entered; at first nothing drives, and everything
    is level and upright. With buttons that can be held it drives, and jogs a leg, while they are;
    else sliders drive, and no leg is jogged.

    State: discrete, each output; clicks seen of each button and the end of the moment (4);
    updated every period.

    Bad input: without buttons and sliders requests stay, but nothing drives and no further
    command is given; on a ground that is not finite the sliders' ranges stay.
    """

    BUTTONS = ("Go", "Stop", "Reset")
    # Name, smallest and largest value, step; and the factor to SI.
    DRIVE = (("drive [m/s]", -0.5, 0.5, 0.05, 1.0), ("turn [deg/s]", -20.0, 20.0, 1.0, radians(1)))
    # Buttons that are held, their keys; forward speed and yaw rate [m/s, rad/s].
    HELD_DRIVE = (
        ("ahead", "ArrowUp", (0.3, 0.0)),
        ("back", "ArrowDown", (-0.3, 0.0)),
        ("left", "ArrowLeft", (0.0, radians(10.0))),
        ("right", "ArrowRight", (0.0, radians(-10.0))),
    )
    # And direction by leg; a longer actuator raises the foot. At this rate [m/s].
    JOG_RATE = 0.002
    HELD_JOG = tuple(
        (f"leg {leg + 1} {way}", leg, sign)
        for leg in range(LEG_COUNT)
        for way, sign in (("up", 1.0), ("down", -1.0))
    )
    # For how long a command is given [s].
    MOMENT = 0.2

    def __init__(
        self,
        controls: Controls,
        height: float = 0.477,
        geometry: PlatformGeometry = PlatformGeometry(),
        params: PostureSlidersParams | None = None,
        period: float = 0.05,
        joints: Sequence[ArmJoint] = PAPER_ARM.joints,
    ):
        """Creates the source; shows nothing yet.

        Args:
            controls: owner of sliders and buttons: a `Meshcat`, or one with its methods.
            height: height of the level posture [m].
            geometry: the platform.
            params: ranges of the posture's sliders; None: those for the geometry.
            period: period of reading the controls [s].
            joints: joints (n) of the arm, which may be none.
        """
        super().__init__(controls, height, geometry, params, period)
        self.arm = [slider_of(joint) for joint in joints]
        if self.arm:
            request = self.DeclareDiscreteState(len(self.arm))
            self._outputs["arm_request"] = request
            self.DeclareStateOutputPort("arm_request", request)

    def _declare(self) -> None:
        self.set_name("operator_controls")
        self._outputs: dict[str, Any] = {}
        for name, start in (
            ("operator", [0.0]),
            ("drive_request", [0.0, 0.0]),
            ("posture_request", self._level),
            ("jog_request", [0.0] * LEG_COUNT),
            ("operator_age", [0.0]),
        ):
            self._outputs[name] = self.DeclareDiscreteState(np.array(start))
            self.DeclareStateOutputPort(name, self._outputs[name])
        self._memory: Any = self.DeclareDiscreteState(np.zeros(4))

    def shown(self) -> AbstractContextManager[None]:
        """Shows buttons and sliders, and takes them away at the end."""
        driving = () if self._can_be_held else self.DRIVE
        more = [
            (*slider[:4], min(max(0.0, slider[1]), slider[2])) for slider in (*driving, *self.arm)
        ]
        holds = [(name, key) for name, key, _ in self.HELD_DRIVE]
        holds += [(name, "") for name, _, _ in self.HELD_JOG]
        return shown(
            self._controls,
            [*more, *self._sliders()],
            self.BUTTONS,
            holds if self._can_be_held else (),
        )

    @property
    def _can_be_held(self) -> bool:
        return hasattr(self._controls, "IsHeld")

    def _update(self, context: Context, discrete_state: Any) -> None:
        posture = self._read_posture()
        *values, until = elements(context.get_discrete_state(self._memory))
        now = context.get_time()
        command = context.get_discrete_state(self._outputs["operator"])[0]
        drive, jog = np.zeros(2), np.zeros(LEG_COUNT)
        if posture is not None:
            discrete_state.set_value(self._outputs["posture_request"], posture)
            drive, jog = self._read_held() if self._can_be_held else (self._read(self.DRIVE), jog)
            if self.arm:
                discrete_state.set_value(self._outputs["arm_request"], self._read(self.arm))
            clicks = [float(self._controls.GetButtonClicks(name)) for name in self.BUTTONS]
            pressed = [i for i, count in enumerate(clicks) if count > values[i]]
            values = clicks
            if pressed:
                # Of several at once the one that is safest.
                order = (Command.STOP, Command.RESET, Command.GO)
                command = min((Command(1 + i) for i in pressed), key=order.index)
                until = now + self.MOMENT
            self._fit(context, posture)
        if now >= until - 1e-9:
            command = Command.NONE
        discrete_state.set_value(self._outputs["operator"], np.array([float(command)]))
        discrete_state.set_value(self._outputs["drive_request"], drive)
        discrete_state.set_value(self._outputs["jog_request"], jog)
        if hasattr(self._controls, "silence"):
            # As large as it is useful, so that it is finite.
            age = min(self._controls.silence(), _LONGEST)
            discrete_state.set_value(self._outputs["operator_age"], np.array([age]))
        discrete_state.set_value(self._memory, np.array([*values, until]))

    def _read_held(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Drive and jog requests of the buttons that are held."""
        drive, jog = np.zeros(2), np.zeros(LEG_COUNT)
        for name, _, request in self.HELD_DRIVE:
            drive += np.array(request) * self._controls.IsHeld(name)
        for name, leg, sign in self.HELD_JOG:
            jog[leg] += sign * self.JOG_RATE * self._controls.IsHeld(name)
        return drive, jog

    def _read(self, sliders: Sequence[Slider]) -> NDArray[Any]:
        return np.array([s[-1] * self._controls.GetSliderValue(s[0]) for s in sliders])


# Largest angle and way to either side of a joint that has no limits [deg, mm].
_TURN, _WAY = 90.0, 500.0


def slider_of(joint: ArmJoint) -> Slider:
    """Name, smallest and largest value, step, and the factor to SI of a joint's slider."""
    unit, usual, factor = ("deg", _TURN, radians(1)) if joint.unit == "rad" else ("mm", _WAY, 1e-3)
    low = joint.lower / factor if isfinite(joint.lower) else -usual
    high = joint.upper / factor if isfinite(joint.upper) else usual
    return f"{joint.name} [{unit}]", low, high, 1.0, factor


class TipSliders(LeafSystem):
    """Commands the point of the arm's tip that three sliders show.

    | port | size | unit | meaning |
    |---|---|---|---|
    | out `tip_command` | 3 | m | the point in the world; jumps |

    The sliders exist while `shown` is entered; they start where the tip is when the platform is
    level and the arm at zero, and go as far as the arm from there, not below the ground. What
    cannot be reached is left to `TipFeedforward` with `on_unreachable="clamp"`.

    State: discrete, the command (3), read from the sliders every period.

    Bad input: while there are no sliders the last command stays.
    """

    NAMES = ("tip x [mm]", "tip y [mm]", "tip z [mm]")

    def __init__(
        self, controls: Controls, carried: CarriedArm, height: float, period: float = 0.05
    ):
        """Creates the source; shows nothing yet.

        Args:
            controls: owner of the sliders: a `Meshcat`, or one with its methods.
            carried: platform and arm.
            height: height of the level platform [m].
            period: period of reading the sliders [s].
        """
        super().__init__()
        self.set_name("tip_sliders")
        self._controls, self._carried = controls, carried
        still = [0.0] * carried.arm.count
        self._start = np.round(carried.tip_position((0.0, 0.0, height), still), 3)
        self.DeclareStateOutputPort("tip_command", self.DeclareDiscreteState(self._start))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def shown(self) -> AbstractContextManager[None]:
        """Shows the sliders, and takes them away at the end."""
        low, high = np.floor(1e2 * self._carried.extent) * 10.0 + [[0.0], [10.0]]
        low[2] = max(0.0, low[2])
        ends = zip(self.NAMES, low.tolist(), high.tolist(), (1e3 * self._start), strict=True)
        return shown(self._controls, [(name, a, b, 10.0, float(at)) for name, a, b, at in ends])

    def _update(self, context: Context, discrete_state: Any) -> None:
        if all(name in self._controls.GetSliderNames() for name in self.NAMES):
            values = [1e-3 * self._controls.GetSliderValue(name) for name in self.NAMES]
            discrete_state.set_value(np.array(values))
