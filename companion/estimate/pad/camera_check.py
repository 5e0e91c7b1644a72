"""The camera's delay and the pad's scale, learnt in flight: how the pad seems to move against our own motion.

A frame that was exposed d later than its stamp says takes the attitude of another moment: a vehicle that
turns at w sees the pad jump by -d w x q, although nothing moves. A pad that is printed smaller than its file
says, or a focal length that is wrong, makes every distance k times what it is, and the pad seems to move k
times as the vehicle does. An IMU that sits r (body) from where it is taken to be swings by R r where the
vehicle turns: at a swing of w rad/s that looks like a scale of 1 + w^2 r / g, 20 % of 0.1 m. What `LeverArm`
knows of r is where it begins. A camera that is turned by m (body, small) and whose focal length is wrong by
f shows the pad aside by m x p, and deeper by f (c . p) c along its optical axis c: 2 deg and 1.5 % are 0.3 m
of 7 m, which turn with the view as the vehicle tilts to move, and look like a scale where it tilts far. All
are constants of one linear filter, beside the pad's own motion (q, v: position and velocity relative to the
IMU as they are seen, NED; a: the pad's acceleration, a Gauss-Markov process; U: the IMU's own motion beyond
constant velocity):

    predict   q += v dt + a dt^2 / 2 - k U_q        v += a dt - k U_v        a *= exp(-dt / tau)
    sighting  z = q + R (r + m x p + f (c . p) c) - (d - d0) w x z + noise
                                                    z = R p; d0: the delay that is corrected already
    echo      k h = (q + R r)_down + noise          h: the height over the board

Where a fix corrects the attitude by a small rotation, q, v and a - g turn with it (see `frame_correction`).

The scale is told as what the pad's distance is off by: k, and f. Errors that wander with the way it flies
(attitude, a lens's distortion) look like a scale for seconds, and no
variance of the filter's knows of them; the spans of time do. What each has told, by the information that it
has added, scatters about the estimate by more than it should, and by so much more motion's word is less sure
(R. T. Birge, Phys. Rev. 40, 1932); one span alone says nothing. An echo's word needs no motion.

What the pad shares with a vehicle that follows it is slow, and goes to its acceleration. A vehicle that
neither moves nor turns shows nothing but by its echoes.

Where the IMU comes by the link, the delay may be the link's: TIMESYNC takes half of a round trip for each
direction, so that its times are late by d where what comes is slower than what goes by 2 d. They are late by
half of the round trip at most; the rest is the camera's. SI units.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import Final, NamedTuple

import numpy as np

from companion.base.geometry import (
    DOWN,
    EYE3,
    GRAVITY_M_S2,
    FloatArray,
    Quaternion,
    Vector3,
    cross,
    down_in_body,
    matrix_from_quat,
    norm,
    quat_rotate,
    scale,
    subtract,
    vector3,
)
from companion.base.messages import Quantity, SourceComparison
from companion.config.estimate import PadFilterConfig
from companion.estimate.motion import RATE_SPAN_S, MotionHistory, rotation_lever
from companion.estimate.pad.pad_types import HIGHEST_ECHO_M, HeightMeasurement

SCALE_STD: Final = 0.3  # before anything is known
SCALE_WALK_RTS: Final = 1e-3  # a lens that heats, an echo's air
SCALE_SPAN_S: Final = 3.0  # of sightings
DELAY_WALK_S_RTS: Final = 1e-3  # 8 ms in a minute: clocks drift apart; judged, not measured
# of one that speeds up, brakes or turns; judged: 1.5 m/s2 are tested to be no scale
PAD_ACCELERATION_M_S2: Final = 2.0
# so long; by the pad filter's 1.5 s a pad of 71 % was not refused in small fast swings any more
PAD_ACCELERATION_S: Final = 2.0
NOISE_M: Final = 0.005  # of a sighting's, at least: calibration errors, which turn with the view
# of the attitude, from one second to the next, besides the noise of the gyroscope
NOISE_RAD: Final = 0.003
ATTITUDE_WANDERS_S: Final = 1.0  # see above
SQUARE: Final = 1.1  # so near to the least noise of an echo it comes square to the board
ECHO_SCALE_STD: Final = 0.003  # the speed of sound, which does not average out
# what a builder measures: how the camera is turned, and its focal length, as a share
MOUNT_STD_RAD: Final = 0.02
FOCAL_STD: Final = 0.01  # see above
# lower, an offset of the echoes of some centimetres, which never averages out, would pass for a wrong scale
LOWEST_ECHO_M: Final = 1.0
ECHO_APART_S: Final = 0.05  # an echo and a sighting of one moment
LONGEST_GAP_S: Final = 1.0  # between sightings; then the pad's motion begins again, scale and delay stay
OUTLIER: Final = 5.0  # standard deviations: a sighting of something else, not of noise
MEDIAN_OF: Final = 7  # echoes
LARGEST_DELAY_S: Final = 0.1  # stamps that are 90 ms off have been learnt to 1 ms
UNSETTLED_S: Final = 0.005  # what is still to be corrected of the delay: less does not show in the scale
SLEW: Final = 0.01  # s a second: what is corrected moves slowly, so that sightings stay in order
_Q, _V, _A, _K, _D, _R = slice(0, 3), slice(3, 6), slice(6, 9), 9, 10, slice(11, 14)
_F, _BODY = 17, slice(11, 18)  # m is 14:17
_STATES: Final = _BODY.stop
_EYE: Final = np.eye(_STATES)
_EYE.flags.writeable = False


class _Told(NamedTuple):
    """What spans of time have each told of the scale, by information: sums, for there may be days of them."""

    spans: int = 0
    information: float = 0.0
    off: float = 0.0  # times what each has found beyond 1
    off_square: float = 0.0  # times the square of that

    def after(self, found: float, information: float) -> _Told:
        """With one more."""
        off = found - 1.0
        return _Told(
            self.spans + 1,
            self.information + information,
            self.off + information * off,
            self.off_square + information * off * off,
        )

    def scatter(self, scale: float) -> float:
        """Of what they have found about a scale: 1 where it is what their information allows."""
        k = scale - 1.0
        return (self.off_square - 2.0 * k * self.off + k * k * self.information) / (self.spans - 1)


class CameraCheck:
    """Feed it every sighting, and the echoes from over the board.

    `delay_s` is what is corrected of the delay so far: `link_delay_s` of it is to be taken off the times that
    the link gives, `frame_delay_s` to be added to the frames'.
    """

    def __init__(
        self,
        motion: MotionHistory,
        config: PadFilterConfig,
        board_half_width_m: float,
        optical_axis_body: Vector3 = (0.0, 0.0, 1.0),
    ) -> None:
        """Of the settings those of the stamps' delay, of an echo's noise and of a pad's first speed."""
        delay_std_s, self._echo_noise_m = config.camera_delay_std_s, config.range_noise_m
        self._first_speed_m_s = config.first_speed_std_m_s
        self._axis = np.array(optical_axis_body)
        self._motion, self._half_width_m = motion, board_half_width_m
        self._delay_walk = DELAY_WALK_S_RTS if delay_std_s > 0.0 else 0.0
        self.delay_s = 0.0
        self.imu_by_link, self.half_trip_s = False, 0.0  # of the link's round trip; 0: not known
        self.link_delay_s = 0.0
        self._x = np.zeros(_STATES)
        camera = [MOUNT_STD_RAD**2] * 3 + [FOCAL_STD**2]
        self._P = np.diag([0.0] * 10 + [delay_std_s**2] + [0.0] * 3 + camera)
        self._down_body: Vector3 = DOWN  # at the last sighting
        self.begin_anew()

    def begin_anew(self) -> None:
        """Forget what was compared, but the delay: another mission, or a time that no clock shows."""
        self._time_s = -math.inf
        self._echoes: deque[tuple[float, float]] = deque(maxlen=4)  # time (s), our height over it (m)
        self._heights_m: tuple[float, float, float] | None = None  # when, as it is seen, by echoes
        self._ratios: list[float] = []  # of the height that is seen to the echo's
        self._forget_scale()

    def begin_motion(self) -> None:
        """Forget the pad's motion, which was seen by attitudes that were wrong; scale and delay stay."""
        self._time_s = -math.inf

    def _forget_scale(self) -> None:
        self._x[_K] = 1.0
        self._P[_K, :], self._P[:, _K] = 0.0, 0.0
        self._P[_K, _K] = SCALE_STD**2
        # the present span's time and beginning (mean, variance), and what the earlier ones have told; whether
        # echoes have
        self._span_s, self._span_began = 0.0, (1.0, SCALE_STD**2)
        self._told = _Told()
        self._heard = False

    @property
    def frame_delay_s(self) -> float:
        """What is to be added to the frames' stamps (s)."""
        return self.delay_s - self.link_delay_s

    @property
    def scale(self) -> tuple[float, float]:
        """How many times as far away the pad seems as it is, and the standard deviation."""
        k = float(self._x[_K] + self._x[_F])
        variance = float(self._P[_K, _K] + 2.0 * self._P[_K, _F] + self._P[_F, _F])
        if self._heard:
            return k, math.sqrt(variance + ECHO_SCALE_STD**2)
        if self._told.spans < 2:
            return k, SCALE_STD
        return k, min(SCALE_STD, math.sqrt(variance * max(1.0, self._told.scatter(k))))

    @property
    def delay_std_s(self) -> float:
        """Standard deviation of the delay's estimate (s)."""
        return math.sqrt(float(self._P[_D, _D]))

    def take_echo(self, time_s: float, echo: HeightMeasurement) -> None:
        """Take the height of the sensor over what is below it; aslant the beam's nearest point is another."""
        if not LOWEST_ECHO_M <= echo.height_m <= HIGHEST_ECHO_M or echo.noise_m > SQUARE * self._echo_noise_m:
            return
        self._echoes.append((time_s, echo.height_m + echo.sensor_offset_ned_m[2]))

    def take(self, time_s: float, pad_position_body_m: Vector3, variance_m2: float) -> None:
        """Take a sighting at its corrected time; `variance_m2` is its position's, an axis."""
        attitude = self._motion.attitude(time_s)
        if attitude is None or time_s <= self._time_s:
            return
        seen = quat_rotate(attitude, pad_position_body_m)
        self._down_body = down_in_body(attitude)
        attitude_rad2 = NOISE_RAD**2 + self._motion.turn_density_rad2_s * ATTITUDE_WANDERS_S
        noise_m2 = variance_m2 + NOISE_M**2 + attitude_rad2 * norm(seen) ** 2
        if time_s - self._time_s > LONGEST_GAP_S:
            self._begin(attitude, pad_position_body_m, noise_m2)
        else:
            self._predict(time_s)
            rate = self._rate_ned_rad_s(time_s, attitude)
            # by a horizon that wanders as much as this filter takes it to, motion tells nothing of the scale
            quiet = attitude_rad2 <= 2.0 * NOISE_RAD**2
            self._see(attitude, pad_position_body_m, cross(rate, seen), noise_m2, scale=quiet)
            self._follow(time_s - self._time_s)
            self._end_span(time_s - self._time_s)
        self._time_s = time_s
        for echo in tuple(self._echoes):
            if abs(echo[0] - time_s) <= ECHO_APART_S:
                self._echoes.remove(echo)
                self._hear(*echo)

    def _rate_ned_rad_s(self, time_s: float, attitude: Quaternion) -> Vector3:
        """How fast the vehicle turns: what corrects the attitude is no turn."""
        newest_s = self._motion.newest_s
        end_s = min(time_s + 0.5 * RATE_SPAN_S, math.inf if newest_s is None else newest_s)
        corrected = self._motion.corrected(end_s - RATE_SPAN_S, end_s)
        rate = quat_rotate(attitude, self._motion.rate_body_rad_s(time_s))
        return subtract(rate, scale(corrected, 1.0 / RATE_SPAN_S))

    def _body(self, attitude: Quaternion, pad_body_m: Vector3) -> FloatArray:
        """How the pad's place as seen (NED) changes by what is constant in the body (3, 7)."""
        columns = np.zeros((3, 7))
        columns[:, :3] = EYE3
        columns[:, 3:6] = rotation_lever(pad_body_m)
        columns[:, 6] = self._axis * (self._axis @ np.array(pad_body_m))
        turned: FloatArray = matrix_from_quat(attitude) @ columns
        return turned

    def _begin(self, attitude: Quaternion, pad_body_m: Vector3, noise_m2: float) -> None:
        """The pad's motion anew; it is from the IMU, as far as it is known where that is."""
        x, P, H = self._x, self._P, self._body(attitude, pad_body_m)
        x[_R], P[_R, :], P[:, _R] = 0.0, 0.0, 0.0
        P[_R, _R] = self._motion.imu_covariance_m2
        seen = np.array(quat_rotate(attitude, pad_body_m))
        x[_Q], x[_V], x[_A] = seen - H @ x[_BODY], 0.0, 0.0
        P[:9, :], P[:, :9] = 0.0, 0.0
        spread = (noise_m2, self._first_speed_m_s**2, PAD_ACCELERATION_M_S2**2)
        P[:9, :9] = np.diag(np.repeat(spread, 3))
        P[_Q, _K:] = -H @ P[_BODY, _K:]
        P[_K:, _Q] = P[_Q, _K:].T
        P[_Q, _Q] += H @ P[_BODY, _BODY] @ H.T

    def _turn(self, dt: float, correction_rad: Vector3) -> None:
        """A corrected attitude turns what was seen before with it."""
        x = self._x
        place, speed = vector3(x[_Q] + dt * x[_V]), vector3(x[_V])
        pushed = cross(correction_rad, (0.0, 0.0, -GRAVITY_M_S2))
        x[_Q] += subtract(cross(correction_rad, place), scale(pushed, dt * dt / 3.0))
        x[_V] += subtract(cross(correction_rad, speed), scale(pushed, 0.5 * dt))
        x[_A] += pushed

    def _predict(self, time_s: float) -> None:
        dt = time_s - self._time_s
        self._turn(dt, self._motion.corrected(self._time_s, time_s))
        moved, sped = (np.array(u) for u in self._motion.moved(self._time_s, time_s)[:2])
        fade = math.exp(-dt / PAD_ACCELERATION_S)
        F = _EYE.copy()
        F[_Q, _V] = F[_V, _A] = dt * EYE3
        F[_Q, _A], F[_A, _A] = 0.5 * dt * dt * EYE3, fade * EYE3
        F[_Q, _K], F[_V, _K] = -moved, -sped
        self._x = F @ self._x
        push = PAD_ACCELERATION_M_S2**2 * (1.0 - fade * fade)
        shaken = self._motion.noise_density_m2_s3 * dt
        pushed = np.array([dt * dt / 6.0, 0.5 * dt, 1.0])
        # a noisy gyroscope's horizon wanders, and gravity with it: an acceleration of nobody's
        leans = GRAVITY_M_S2**2 * self._motion.turn_density_rad2_s * dt
        added = push * (pushed[:, None] * pushed)
        added.reshape(-1)[::4] += (shaken * dt * dt / 3.0, shaken, leans)
        P = F @ self._P @ F.T
        for axis in range(3):
            P[axis:9:3, axis:9:3] += added
        P[_K, _K] += SCALE_WALK_RTS**2 * dt
        P[_D, _D] += self._delay_walk**2 * dt
        self._P = P

    def _see(
        self, attitude: Quaternion, pad_body_m: Vector3, sweep_m_s: Vector3, noise_m2: float, *, scale: bool
    ) -> None:
        seen, sweep = np.array(quat_rotate(attitude, pad_body_m)), np.array(sweep_m_s)
        H = np.zeros((3, _STATES))
        H[:, _Q] = EYE3
        H[:, _D] = -sweep
        H[:, _BODY] = self._body(attitude, pad_body_m)
        self._update(seen - self.delay_s * sweep - H @ self._x, H, noise_m2 * EYE3, scale=scale)

    def _follow(self, elapsed_s: float) -> None:
        wanted_s = max(-LARGEST_DELAY_S, min(LARGEST_DELAY_S, float(self._x[_D])))
        if abs(wanted_s - self.delay_s) > UNSETTLED_S:
            self._forget_scale()  # by another moment's motion
        reach_s = SLEW * elapsed_s
        self.delay_s += max(-reach_s, min(reach_s, wanted_s - self.delay_s))
        links_s = max(0.0, min(self.delay_s, self.half_trip_s)) if self.imu_by_link else 0.0
        self.link_delay_s += max(-reach_s, min(reach_s, links_s - self.link_delay_s))

    def _end_span(self, elapsed_s: float) -> None:
        """Note what the last span of time alone has told of the scale."""
        self._span_s += elapsed_s
        if self._span_s < SCALE_SPAN_S:
            return
        (before, variance), now = self._span_began, (float(self._x[_K]), float(self._P[_K, _K]))
        told = 1.0 / now[1] - 1.0 / variance
        if told > 0.0:
            self._told = self._told.after((now[0] / now[1] - before / variance) / told, told)
        self._span_s, self._span_began = 0.0, now

    def _hear(self, echo_s: float, height_m: float) -> None:
        """Of some echoes the median counts: single ones come from anywhere between sensor and floor."""
        north, east, down = self._x[_Q].tolist()
        down += float(np.dot(self._down_body, self._x[_R]))
        if height_m <= 0.0 or math.hypot(north, east) > self._half_width_m:
            return
        seen_m = down - (self._time_s - echo_s) * float(self._x[5])
        self._ratios.append(seen_m / height_m)
        if len(self._ratios) < MEDIAN_OF:
            return
        height_m = down / max(median(self._ratios), 0.01)
        self._ratios.clear()
        self._heights_m = (self._time_s, down, height_m)
        H = np.zeros((1, _STATES))
        H[0, 2], H[0, _K], H[0, _R] = 1.0, -height_m, self._down_body
        variance = 0.5 * math.pi / MEDIAN_OF * (float(self._x[_K]) * self._echo_noise_m) ** 2
        self._update(-H @ self._x, H, np.array([[variance]]))
        self._heard = True

    def _update(self, y: FloatArray, H: FloatArray, R: FloatArray, *, scale: bool = True) -> None:
        """An update; without `scale` that is only considered (Schmidt): it learns nothing."""
        PH = self._P @ H.T
        S = H @ PH + R
        inverse = np.linalg.inv(S)
        if y @ inverse @ y > OUTLIER**2 * len(y):
            return
        K = PH @ inverse
        if not scale:
            K[_K] = 0.0
        self._x = self._x + K @ y
        KPH = K @ PH.T
        P = self._P - KPH - KPH.T + K @ S @ K.T
        self._P = 0.5 * (P + P.T)

    # ------------------------------------------------------------ as compared

    @property
    def comparisons(self) -> tuple[SourceComparison, ...]:
        """Scale (%) and delay (ms) against what the files say; none before the first sighting."""
        if self._time_s == -math.inf:
            return ()
        (k, k_std), d = self.scale, float(self._x[_D])
        return (
            *self._height,
            SourceComparison(
                self._time_s,
                Quantity.PAD_SCALE,
                "100 %",
                f"{100.0 / max(k, 0.01):.0f} %",
                difference=100.0 * abs(k - 1.0),  # of the distance: its error is the Gaussian one
                std=100.0 * k_std,
            ),
            SourceComparison(
                self._time_s,
                Quantity.LINK_DELAY if self._by_link(d) else Quantity.CAMERA_DELAY,
                "0 ms off",
                f"{1e3 * d:+.0f} ms",
                difference=1e3 * abs(d),
                std=1e3 * self.delay_std_s,
            ),
        )

    def _by_link(self, delay_s: float) -> bool:
        return self.imu_by_link and abs(delay_s) - self.delay_std_s <= self.half_trip_s

    @property
    def _height(self) -> tuple[SourceComparison, ...]:
        if self._heights_m is None:
            return ()
        time_s, seen_m, heard_m = self._heights_m
        return (
            SourceComparison(
                time_s,
                Quantity.HEIGHT_OVER_PAD,
                f"{seen_m:.2f} m",
                f"{heard_m:.2f} m",
                difference=abs(seen_m - heard_m),
                std=self._echo_noise_m / math.sqrt(MEDIAN_OF),
            ),
        )
