"""A simulated quadrotor that follows a track: PyFlyt's quadrotor and its attitude controller, in PyBullet's physics.

Tai et al., "PyFlyt: UAV simulation environments for reinforcement learning research", 2023. Around PyFlyt's controller of
attitude and climb there is a loop of our own: it asks for the track's acceleration, and for what brings place and velocity back
to the track, and tilts the quadrotor for it. PyFlyt takes the climb in the quadrotor's own frame, where a tilted quadrotor that
flies ahead seems to climb, so that is added to what is asked.
"""

import contextlib
import ctypes
import importlib
import math
import os
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.flight.route import FlightError
from uavbench.flight.track import Track
from uavbench.flight.wind import Wind

_HERTZ = 120  # of PyFlyt's control
_EVERY = 6  # steps of control between two samples of the trace
_GRAVITY = 9.81
_CLIMB = 1.5  # m/s, at take-off and landing
_SETTLE = 2.0  # seconds of hovering after the climb, and before the landing
_LEAD = 0.4  # seconds that the attitude follows late
_PLACE, _VELOCITY, _SUM = 0.8, 1.7, 0.25  # gains: 1/s², 1/s, 1/s³
_DRAG = 0.06  # 1/m: acceleration that PyFlyt's drag takes, by the square of the velocity
_MOST_ACCELERATION, _MOST_SUM = 10.0, 30.0
_HEIGHT_GAIN = 1.5  # 1/s
_GROUND = 0.1  # m: the height at which the quadrotor stands
_CALLED = (  # by PyFlyt, in each step of the physics
    *("LINK_FRAME", "applyExternalForce", "applyExternalTorque", "getBasePositionAndOrientation", "getBaseVelocity"),
    *("getContactPoints", "getEulerFromQuaternion", "getLinkStates", "getMatrixFromQuaternion", "stepSimulation"),
)

#: A box: west, south, east, north in metres, and its height.
Box = tuple[float, float, float, float, float]


@dataclass(frozen=True)
class Trace:
    """What a quadrotor did, sampled 20 times a second.

    Attributes
    ----------
    seconds : ndarray, shape (T,)
    places : ndarray, shape (T, 3)
        Metres east and north of the middle of the map, and above the ground.
    velocities : ndarray, shape (T, 3)
        Over ground, in m/s.
    angles : ndarray, shape (T, 3)
        Roll, pitch and yaw.
    airspeeds : ndarray, shape (T,)
    on_track : (int, int)
        The first sample of the track, and the one after its last: before and after it climbs and lands.
    hit : bool
        Whether the quadrotor touched a box, or the ground on its way, with which the trace ends.
    """

    seconds: NDArray[np.float64]
    places: NDArray[np.float64]
    velocities: NDArray[np.float64]
    angles: NDArray[np.float64]
    airspeeds: NDArray[np.float64]
    on_track: tuple[int, int]
    hit: bool


def fly_track(track: Track, altitude: float, boxes: Sequence[Box], wind: Wind | None, seed: int) -> Trace:
    """Take off, follow a track, and land; the trace is the same for the same arguments.

    Raises
    ------
    FlightError
        When PyFlyt or PyBullet is not installed.
    """
    with _silent():
        aviary_of = _aviary()
        start = np.array([[*track.places[0], _GROUND]])
        aviary = aviary_of(
            start_pos=start,
            start_orn=np.zeros((1, 3)),
            drone_type="quadx",
            drone_options={"drone_model": "primitive_drone", "use_camera": False},
            seed=seed % (2**31 - 1) + 1,  # PyFlyt takes 0 for none
        )
    try:
        _build(aviary, boxes)
        if wind is not None:
            aviary.register_wind_field_function(_field(wind))
        aviary.set_mode(1)  # roll, pitch, yaw and climb
        for name in _CALLED:  # PyBullet's client makes its functions anew at each call, which takes a sixth of the time
            setattr(aviary, name, getattr(aviary, name))
        return _flown(aviary, track, altitude, wind)
    finally:
        with _silent():
            aviary.disconnect()


def _field(wind: Wind) -> Callable[[float, NDArray[np.float64]], NDArray[np.float64]]:
    """Return the wind as PyFlyt asks for it: for a time and places, shape (N, 3)."""

    def field(seconds: float, places: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.tile([*wind.at(seconds), 0.0], (len(places), 1))

    return field


def _aviary() -> Any:
    """Return PyFlyt's class of simulations."""
    try:
        return importlib.import_module("PyFlyt.core").Aviary
    except ImportError as error:
        raise FlightError(f"flights with physics need {error.name}: pip install 'uavbench[flight]'") from None


@contextlib.contextmanager
def _silent() -> Generator[None]:
    """Hide what PyBullet's library writes to the standard output and to the standard error."""
    with contextlib.ExitStack() as stack, Path(os.devnull).open("w", encoding="utf-8") as nothing:
        stack.enter_context(contextlib.redirect_stdout(nothing))
        kept = {stream: os.dup(stream) for stream in (1, 2)}
        try:
            for stream in kept:
                os.dup2(nothing.fileno(), stream)
            yield
        finally:
            with contextlib.suppress(OSError, AttributeError):
                ctypes.CDLL(None).fflush(None)  # what the library has written, but not yet handed over
            for stream, there in kept.items():
                os.dup2(there, stream)
                os.close(there)


def _build(aviary: Any, boxes: Sequence[Box]) -> None:
    """Put up the buildings."""
    for west, south, east, north, height in boxes:
        half = [(east - west) / 2, (north - south) / 2, height / 2]
        shape = aviary.createCollisionShape(aviary.GEOM_BOX, halfExtents=half)
        aviary.createMultiBody(0.0, shape, basePosition=[(east + west) / 2, (north + south) / 2, height / 2])
    aviary.register_all_new_bodies()


class _Pilot:
    """The loop around PyFlyt's controller: from place and velocity to attitude and climb."""

    def __init__(self, start: NDArray[np.float64]) -> None:
        self._last, self._sum = start, np.zeros(2)

    def setpoint(self, state: NDArray[np.float64], place: Any, velocity: Any, acceleration: Any, height: float) -> Any:
        """Return roll, pitch, yaw and climb for PyFlyt. ``state`` is PyFlyt's: rates, angles, own velocities, place."""
        (roll, pitch, _), here = state[1], state[3]
        moving = (here - self._last) * _HERTZ
        self._last = here.copy()
        error = place - here[:2]
        self._sum = np.clip(self._sum + error / _HERTZ, -_MOST_SUM, _MOST_SUM)
        wanted = acceleration + _VELOCITY * (velocity - moving[:2]) + _PLACE * error + _SUM * self._sum
        wanted = wanted + _DRAG * velocity * np.linalg.norm(velocity)
        wanted = wanted * min(1.0, _MOST_ACCELERATION / max(float(np.linalg.norm(wanted)), 1e-9))
        seems = state[2][2] - moving[2] * math.cos(roll) * math.cos(pitch)
        climb = seems + float(np.clip(_HEIGHT_GAIN * (height - here[2]), -_CLIMB, _CLIMB))
        return np.array([-math.atan2(wanted[1], _GRAVITY), math.atan2(wanted[0], _GRAVITY), 0.0, climb])


def _flown(aviary: Any, track: Track, altitude: float, wind: Wind | None) -> Trace:
    """Return the trace of the quadrotor through the whole flight."""
    rise = altitude / _CLIMB + _SETTLE
    length = float(track.seconds[-1])
    total = rise + length + _SETTLE + altitude / _CLIMB + _SETTLE
    pilot, hit = _Pilot(np.array([*track.places[0], _GROUND])), False
    rows: list[tuple[float, ...]] = []
    for k in range(math.ceil(total * _HERTZ)):
        now = k / _HERTZ
        (place, velocity, _), (_, _, acceleration) = track.at(now - rise), track.at(now - rise + _LEAD)
        lands = now > rise + length + _SETTLE
        state = aviary.state(0)
        aviary.set_setpoint(0, pilot.setpoint(state, place, velocity, acceleration, 0.0 if lands else altitude))
        if k % _EVERY == 0:
            rows.append((now, *state[3], *state[1]))
        aviary.step()
        touched = np.flatnonzero(aviary.contact_array[aviary.drones[0].Id])
        if touched.size and (touched != aviary.planeId).any():
            hit = True
            rows.append(((k + 1) / _HERTZ, *aviary.state(0)[3], *aviary.state(0)[1]))
            break
        if touched.size and (lands or rise <= now):
            hit = not lands  # whoever touches the ground on its way has crashed
            break
    table: NDArray[np.float64] = np.array(rows)
    seconds, places = table[:, 0], table[:, 1:4]
    velocities = np.gradient(places, seconds, axis=0) if len(seconds) > 1 else np.zeros_like(places)
    air = velocities[:, :2] - (np.array([wind.at(now) for now in seconds]) if wind else 0.0)
    airspeeds = np.hypot(np.linalg.norm(air, axis=1), velocities[:, 2])
    begins, ends = np.searchsorted(seconds, [rise, rise + length]).tolist()
    return Trace(seconds, places, velocities, table[:, 4:7], airspeeds, (begins, max(ends, begins)), hit)
