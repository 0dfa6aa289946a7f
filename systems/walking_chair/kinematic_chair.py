"""Quasi-static plant of the walking chair: at every instant at rest on its feet."""

import functools
import weakref
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import batch, declare_cached, read_batch
from parapod.systems.core.quaternions import of_angles
from parapod.systems.core.rows import answer_of
from parapod.systems.core.vectors import product, rotation_columns
from parapod.systems.walking_chair.chair import corners_in_body
from parapod.systems.walking_chair.geometry import BRANCHES, LEG_COUNT, ChairGeometry, by_legs
from parapod.systems.walking_chair.leg import up_of_lengths
from parapod.systems.walking_chair.masses import ChairMasses, Passenger, centre_of_mass
from parapod.systems.walking_chair.statics import STIFFNESS, force_map_at, rest

_CORNERS = 3 * LEG_COUNT


class _Stance(NamedTuple):
    """The chair at an instant; names are those of the ports. Rows are a dimension ahead."""

    body_position: NDArray[np.float64]
    body_attitude: NDArray[np.float64]
    force: NDArray[np.float64]
    contact_force: NDArray[np.float64]
    foot_height: NDArray[np.float64]
    body_pose: NDArray[np.float64]
    seat: NDArray[np.float64]  # (3) place of the passenger on the body
    places: NDArray[np.float64]  # (12, 2) corners in the world
    carry: NDArray[np.bool_]  # (12)

    @property
    def passenger_pose(self) -> NDArray[np.float64]:
        """Calculated on demand, as for drawings."""
        place = self.body_position + product(_rotation(self.body_attitude), self.seat)
        return np.concatenate((self.body_pose[..., :4], place), axis=-1)


class KinematicChair(LeafSystem):
    """The chair as a body at rest on what carries it: no dynamics, contact without slip.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position` | 12 | m | lengths of the branches |
    | out `body_position` | 3 | m | of S in the world |
    | out `body_attitude` | 3 | rad | roll, pitch, yaw |
    | out `force` | 12 | N | with which the actuators hold, positive to extend |
    | out `contact_force` | 4 | N | of the ground on the feet, upwards |
    | out `foot_height` | 12 | m | corners E_1, E_2, E_3 of each foot above the ground |
    | out `body_pose` | 7 | -, m | quaternion (w, x, y, z) and position of the body |
    | out `passenger_pose` | 7 | -, m | the same of the passenger, from the centre of mass |

    Branches are springs on a rigid ground, see `standing`: they share the load, and feet that
    would have to pull lift. A corner that carries stays where it has come to carry; body and
    heading follow from those that stay, each counted as much as it carries.

    State: discrete, place and heading of the body (3) [m, m, rad], where the corners came to
    carry (24) [m] and which of them do (12), updated every period.

    Parameters (Context): mass [kg] and place (x, y, height) [m] of the passenger (4).

    Bad input: NaN where a leg cannot be assembled.
    """

    def __init__(
        self,
        geometry: ChairGeometry = ChairGeometry(),
        masses: ChairMasses = ChairMasses(),
        passenger: Passenger = Passenger(),
        period: float = 0.01,
        place: ArrayLike = (0.0, 0.0),
        stiffness: float = STIFFNESS,
    ):
        """Creates the plant.

        Args:
            geometry: the chair.
            masses: masses of the chair.
            passenger: person on the seat in a default context.
            period: time between looks at what carries [s].
            place: x and y (2) of the body in a default context, where it looks ahead [m].
            stiffness: axial stiffness of a branch [N/m].
        """
        super().__init__()
        self.set_name("kinematic_chair")
        self._geometry, self._masses, self._stiffness = geometry, masses, stiffness
        self._position = self.DeclareVectorInputPort("position", len(BRANCHES))
        self._passenger = self.DeclareNumericParameter(BasicVector(_numbers(passenger)))
        self.DeclareDiscreteState(_looking_ahead(place))
        self.DeclareDiscreteState(3 * _CORNERS)
        self._stance = declare_cached(
            self,
            "stance",
            self._calc_stance,
            {self._position.ticket(), self.xd_ticket(), self.all_parameters_ticket()},
        )
        for name, size in (
            ("body_position", 3),
            ("body_attitude", 3),
            ("force", len(BRANCHES)),
            ("contact_force", LEG_COUNT),
            ("foot_height", _CORNERS),
            ("body_pose", 7),
            ("passenger_pose", 7),
        ):
            calc = functools.partial(_copy_signal, weakref.ref(self), name)
            self.DeclareVectorOutputPort(name, size, calc, {self._stance.ticket})
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_contacts)

    def stand(
        self,
        root_context: Context,
        place: ArrayLike,
        passenger: Passenger,
    ) -> None:
        """Puts the body above a place, looking ahead; the feet come to stand where they are.

        Args:
            root_context: context of the diagram that holds this system.
            place: x and y (2) of the body in the world [m].
            passenger: person on the seat.
        """
        self.put(root_context, _looking_ahead(place))
        self.seat(root_context, passenger)

    def put(self, root_context: Context, place: ArrayLike) -> None:
        """Puts the body at a place, whatever carries it.

        Args:
            root_context: context of the diagram that holds this system.
            place: x, y [m] and heading [rad] (3) of the body in the world.
        """
        context = self.GetMyMutableContextFromRoot(root_context)
        context.SetDiscreteState(0, np.asarray(place, dtype=float))
        context.SetDiscreteState(1, np.zeros(3 * _CORNERS))

    def seat(self, root_context: Context, passenger: Passenger) -> None:
        """Exchanges the passenger, in the context of the diagram that holds this system."""
        context = self.GetMyMutableContextFromRoot(root_context)
        seat: Any = context.get_mutable_numeric_parameter(self._passenger)
        seat.SetFromVector(_numbers(passenger))

    def signal(self, context: Context, name: str) -> NDArray[np.float64]:
        """The signal of that name, from the one solution that all of them share."""
        signal: NDArray[np.float64] = getattr(self._stance.value(self, context), name)
        return signal

    def _calc_stance(self, context: Context) -> _Stance:
        up = up_of_lengths(self._geometry.leg, by_legs(read_batch(self._position, context)))
        corners = corners_in_body(self._geometry, up)
        batch_shape = up.shape[:-2]
        if not answer_of(np.isfinite(corners).all(axis=(-3, -2, -1))):
            return _unknown(batch_shape)
        seat = batch(context.get_numeric_parameter(self._passenger), context)
        passenger = Passenger(*np.moveaxis(seat, -1, 0))
        mass, centre = centre_of_mass(self._masses, passenger, corners.mean(axis=-2))
        flat = corners.reshape(*batch_shape, _CORNERS, 3)
        vertical = force_map_at(self._geometry, up)[..., 2]
        foot_weight = self._masses.foot_end * GRAVITY
        carried = batch(context.get_discrete_state(1), context)[..., 2 * _CORNERS :] > 0.5
        at_rest = rest(
            flat, vertical, mass * GRAVITY, centre, foot_weight, self._stiffness, carried
        )
        tilt = np.stack((at_rest.roll, at_rest.pitch, np.zeros_like(at_rest.roll)), axis=-1)
        places = (flat @ np.swapaxes(_rotation(tilt), -1, -2))[..., :2]
        carry = at_rest.loads > 0.0
        x_y, yaw = self._place(context, places, np.where(carry, at_rest.loads, 0.0))
        attitude = np.concatenate((tilt[..., :2], yaw), axis=-1)
        position = np.concatenate((x_y, at_rest.height[..., np.newaxis]), axis=-1)
        turn = np.stack(of_angles(*np.moveaxis(attitude, -1, 0)), axis=-1)
        heading_T = np.swapaxes(_heading(yaw[..., 0]), -1, -2)
        return _Stance(
            position,
            attitude,
            at_rest.branch_forces,
            by_legs(at_rest.loads).sum(axis=-1),
            at_rest.gaps,
            np.concatenate((turn, position), axis=-1),
            passenger.place,
            places @ heading_T + x_y[..., np.newaxis, :],
            carry,
        )

    def _place(
        self, context: Context, corners: NDArray[np.float64], loads: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Place (..., 2) and heading (..., 1) that leave corners that carry where they are."""
        contacts = batch(context.get_discrete_state(1), context)
        anchors = contacts[..., : 2 * _CORNERS].reshape(corners.shape)
        share = loads * contacts[..., 2 * _CORNERS :]
        if not answer_of(share.any(axis=-1)):
            last = batch(context.get_discrete_state(0), context)
            return last[..., :2], last[..., 2:]
        share = (share / share.sum(axis=-1, keepdims=True))[..., np.newaxis, :]
        middle, anchors_middle = share @ corners, share @ anchors
        from_middle, anchors_from_middle = corners - middle, anchors - anchors_middle
        along = product(share, (from_middle * anchors_from_middle).sum(axis=-1))
        across = product(
            share,
            from_middle[..., 0] * anchors_from_middle[..., 1]
            - from_middle[..., 1] * anchors_from_middle[..., 0],
        )
        yaw = np.arctan2(across, along)
        moved = product(_heading(yaw[..., 0]), middle[..., 0, :])
        return anchors_middle[..., 0, :] - moved, yaw

    def _update_contacts(self, context: Context, discrete_state: Any) -> None:
        stance: _Stance = self._stance.value(self, context)
        if not answer_of(np.isfinite(stance.body_position).all(axis=-1)):
            return
        contacts = batch(context.get_discrete_state(1), context)
        places = stance.places.reshape(*contacts.shape[:-1], 2 * _CORNERS)
        carried = contacts[..., 2 * _CORNERS :] > 0.5
        stays = np.repeat(carried & stance.carry, 2, axis=-1)
        anchored = np.where(stays, contacts[..., : 2 * _CORNERS], places)
        x_y, yaw = stance.body_position[..., :2], stance.body_attitude[..., 2:]
        discrete_state.set_value(0, np.concatenate((x_y, yaw), axis=-1))
        discrete_state.set_value(1, np.concatenate((anchored, stance.carry), axis=-1))


def _looking_ahead(place: ArrayLike) -> NDArray[np.float64]:
    return np.append(np.asarray(place, dtype=float), 0.0)


def _numbers(passenger: Passenger) -> NDArray[np.float64]:
    return np.array((passenger.mass, passenger.x, passenger.y, passenger.height))


def _rotation(attitude: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3, 3) rotations by roll, pitch and yaw (..., 3)."""
    columns = rotation_columns(*np.moveaxis(attitude, -1, 0))
    return np.stack([np.stack(column, axis=-1) for column in columns], axis=-1)


def _heading(yaw: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 2, 2) rotations by angles (...)."""
    sine, cosine = np.sin(yaw), np.cos(yaw)
    return np.stack((cosine, -sine, sine, cosine), axis=-1).reshape(*yaw.shape, 2, 2)


def _unknown(shape: tuple[int, ...]) -> _Stance:
    def nan(*sizes: int) -> NDArray[np.float64]:
        return np.full((*shape, *sizes), np.nan)

    return _Stance(
        body_position=nan(3),
        body_attitude=nan(3),
        force=nan(len(BRANCHES)),
        contact_force=nan(LEG_COUNT),
        foot_height=nan(_CORNERS),
        body_pose=nan(7),
        seat=nan(3),
        places=nan(_CORNERS, 2),
        carry=np.zeros((*shape, _CORNERS), dtype=np.bool_),
    )


def _copy_signal(
    chair: weakref.ref[KinematicChair], name: str, context: Context, output: BasicVector
) -> None:
    """Calculates one output port; knows the system weakly, as a port must not keep it alive."""
    system = chair()
    assert system is not None
    output.SetFromVector(system.signal(context, name))
