"""Where vehicles are and how they move, as arrays: one row a vehicle, written as telemetry comes."""

import math
from array import array
from struct import Struct
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

_LAYOUT: Final = np.dtype(
    [
        ("position_ned_m", "<f8", (3,)),
        ("velocity_ned_m_s", "<f8", (3,)),
        ("boot_time_s", "<f8"),
        ("position_at_s", "<f8"),
        ("ground_ned_m", "<f8", (3,)),
        ("yaw_rad", "<f8"),
        ("lean_rad", "<f8", (2,)),
    ]
)
_ALL: Final = Struct("<14d")
_MOTION: Final = Struct("<8d")
_GROUND: Final = Struct("<3d")
_ATTITUDE: Final = Struct("<3d")
_VELOCITY: Final = Struct("<4d")  # and when it was measured
_GROUND_OFFSET: Final = _MOTION.size
_ATTITUDE_OFFSET: Final = _MOTION.size + _GROUND.size
VELOCITIES_S: Final = 0.15  # between velocities that are kept: a change over so long is more than their noise
# Numbers go in and out as bytes: NumPy takes ten times as long for one cell of a row.


class State(NamedTuple):
    """One vehicle's row; what is not known is NaN.

    Attributes:
        north_m, east_m, down_m: Position [m; NED from the vehicle's own local origin].
        north_m_s, east_m_s, down_m_s: Velocity [m/s; NED].
        boot_time_s: The vehicle's clock at that sample [s].
        position_at_s: Our loop time when that sample came [s]; minus infinity before the first.
        ground_north_m, ground_east_m, ground_down_m: The last position while disarmed [m; NED].
        yaw_rad: Heading [rad; clockwise from north].
        roll_rad, pitch_rad: Lean, of the same sample [rad].
    """

    north_m: float
    east_m: float
    down_m: float
    north_m_s: float
    east_m_s: float
    down_m_s: float
    boot_time_s: float
    position_at_s: float
    ground_north_m: float
    ground_east_m: float
    ground_down_m: float
    yaw_rad: float
    roll_rad: float
    pitch_rad: float


class StateTable:
    """States of V vehicles.

    Args:
        count: V.

    Attributes:
        position_ned_m: Shape (V, 3) [m; NED from each vehicle's own local origin]; NaN before the first.
        velocity_ned_m_s: Shape (V, 3) [m/s; NED], of the same samples.
        boot_time_s: The vehicles' clocks at these samples, shape (V,) [s]; 0 before the first.
        position_at_s: Our loop time when they came, shape (V,) [s]; minus infinity before the first.
        measured_at_s: Our loop time when they were true by the vehicles' own stamps, shape (V,) [s]; minus infinity
            before the first.
        yaw_rad: Headings, shape (V,) [rad; clockwise from north]; NaN before the first.
        lean_rad: Rolls and pitches, of the same samples, shape (V, 2) [rad].
        earlier_ned_m_s: Velocities of `VELOCITIES_S` to twice that before, and when they were true by our loop time,
            shape (V, 4) [m/s; NED and s]; at NaN while there are none.
    """

    def __init__(self, count: int) -> None:
        nothing = State(*[math.nan] * len(State._fields))._replace(boot_time_s=0.0, position_at_s=-math.inf)
        self._data = bytearray(_ALL.pack(*nothing) * count)
        rows: NDArray[Any] = np.frombuffer(self._data, _LAYOUT)
        self.position_ned_m: NDArray[np.float64] = rows["position_ned_m"]
        self.velocity_ned_m_s: NDArray[np.float64] = rows["velocity_ned_m_s"]
        self.boot_time_s: NDArray[np.float64] = rows["boot_time_s"]
        self.position_at_s: NDArray[np.float64] = rows["position_at_s"]
        self.yaw_rad: NDArray[np.float64] = rows["yaw_rad"]
        self.lean_rad: NDArray[np.float64] = rows["lean_rad"]
        self._measured = array("d", [-math.inf] * count)
        self.measured_at_s: NDArray[np.float64] = np.frombuffer(self._measured)
        self._velocities = bytearray(
            _VELOCITY.pack(0.0, 0.0, 0.0, math.nan) * 2 * count
        )  # each vehicle's earlier and latest
        self._kept_s = [math.nan] * count  # when the latest was true
        self.earlier_ned_m_s: NDArray[np.float64] = np.frombuffer(self._velocities).reshape(count, 2, 4)[:, 0]

    def __getitem__(self, row: int) -> State:
        """Return one vehicle's state."""
        return State._make(self.numbers(row))

    def numbers(self, row: int) -> tuple[float, ...]:
        """Return the numbers of one vehicle's `State`, where a tuple with names would take too long."""
        return _ALL.unpack_from(self._data, row * _ALL.size)

    def __setitem__(self, row: int, state: State) -> None:
        """Set one vehicle's state; it counts as true when it came."""
        self._measured[row] = state.position_at_s
        _ALL.pack_into(self._data, row * _ALL.size, *state)

    def set_motion(self, row: int, *numbers: float) -> None:
        """Set what one position sample says: the first eight numbers of a `State`; it counts as true when it came."""
        self._measured[row] = numbers[7]
        _MOTION.pack_into(self._data, row * _ALL.size, *numbers)

    def set_measured(self, row: int, north_m_s: float, east_m_s: float, down_m_s: float, at_s: float) -> None:
        """Set when the sample of `set_motion` was true by our loop time [s], and keep its velocity for later."""
        self._measured[row] = at_s
        if not 0.0 <= at_s - self._kept_s[row] < VELOCITIES_S:
            size = _VELOCITY.size
            earlier, latest, data = 2 * row * size, (2 * row + 1) * size, self._velocities
            data[earlier:latest] = data[latest : latest + size]
            _VELOCITY.pack_into(data, latest, north_m_s, east_m_s, down_m_s, at_s)
            self._kept_s[row] = at_s

    def ages_s(self, now_s: float) -> NDArray[np.float64]:
        """Return how long ago the samples were true, shape (V,) [s]; infinite before the first."""
        return np.maximum(now_s - self.measured_at_s, 0.0)

    def set_ground(self, row: int, *numbers: float) -> None:
        """Set where a vehicle stands: the three numbers of its ground."""
        _GROUND.pack_into(self._data, row * _ALL.size + _GROUND_OFFSET, *numbers)

    def set_attitude(self, row: int, yaw_rad: float, roll_rad: float, pitch_rad: float) -> None:
        """Set a vehicle's heading and its lean [rad]."""
        _ATTITUDE.pack_into(self._data, row * _ALL.size + _ATTITUDE_OFFSET, yaw_rad, roll_rad, pitch_rad)
