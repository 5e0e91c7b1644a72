"""The autopilots' own precision landing on LANDING_TARGET, in bytes: what each follows, awaits, gives up."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import IDENTITY, Vector3, quat_conjugate, quat_rotate, subtract
from sitl.autopilot.ardupilot.precision_landing import AxisFilter, direction_from_angles
from tests.unit.sitl.autopilot.missions.mission_desk import Station

BODY_FRD, LOCAL_NED = mavlink.MAV_FRAME_BODY_FRD, mavlink.MAV_FRAME_LOCAL_NED
Pad = Callable[[float], Vector3]


def standing(_now_s: float) -> Vector3:
    return (0.6, -0.4, 0.0)


class TargetStation(Station):
    """A station that tells of a target at 20 Hz as long as it is `visible`."""

    def __init__(self, autopilot_kind: AutopilotKind, pad: Pad = standing, **parameters: float) -> None:
        super().__init__(autopilot_kind, 0.1)
        if autopilot_kind == "ardupilot":
            parameters = {"PLND_ENABLED": 1.0, "PLND_OPTIONS": 1.0, **parameters}
        for name, value in parameters.items():
            assert self.flight.autopilot.parameters.set(name, value)
        assert self.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1) == 0
        self.pad = pad
        self.visible = True
        self.by_angles = False
        self.frame = BODY_FRD if autopilot_kind == "ardupilot" else LOCAL_NED
        self.flight.take_off(4.0)

    def land(self, seconds: float) -> None:
        """Say so, and fly on."""
        land = mavlink.MAV_CMD_NAV_LAND if self.autopilot_kind == "ardupilot" else 23
        assert self.command(land) == 0
        self.down(seconds)

    def down(self, seconds: float) -> None:
        """Fly on under targets, until disarmed."""
        for _ in range(round(seconds * 20)):
            if self.visible:
                self.send(self.target())
            self.run(0.05)
            if not self.flight.autopilot.armed:
                return

    def target(self) -> Any:
        vehicle, place = self.flight.vehicle, self.pad(self.flight.now_s)
        x, y, z = quat_rotate(quat_conjugate(vehicle.attitude), subtract(place, vehicle.position))
        distance = math.sqrt(x * x + y * y + z * z)
        angles = (math.atan2(y, z), math.atan2(-x, z)) if self.by_angles else (0.0, 0.0)
        position = place if self.frame == LOCAL_NED else (x, y, z)
        return mavlink.MAVLink_landing_target_message(
            0, 0, self.frame, *angles, distance, 0, 0, *position, IDENTITY, 2, int(not self.by_angles)
        )  # fmt: skip

    @property
    def off_m(self) -> float:
        """Horizontal distance of the vehicle from the pad."""
        place = self.pad(self.flight.now_s)
        return math.dist(self.flight.vehicle.position[:2], place[:2])


@pytest.mark.parametrize(
    ("autopilot_kind", "by_angles"), [("px4", False), ("ardupilot", False), ("ardupilot", True)]
)
def test_it_lands_on_a_pad_that_stands(autopilot_kind: AutopilotKind, by_angles: bool) -> None:
    landing = TargetStation(autopilot_kind)
    landing.by_angles = by_angles  # and a distance, which ArduPilot takes too
    landing.land(40.0)
    assert not landing.flight.autopilot.armed
    assert landing.off_m < 0.1


def moving(now_s: float) -> Vector3:
    return (0.8 * (now_s - 12.0), 0.0, 0.0)


@pytest.mark.parametrize(("options", "lag_m"), [(1.0, 0.1), (0.0, 0.5)])
def test_ardupilot_follows_a_moving_pad_if_set_to(options: float, lag_m: float) -> None:
    landing = TargetStation("ardupilot", moving, PLND_OPTIONS=options, PLND_XY_DIST_MAX=0.1)
    landing.land(8.0)
    assert (landing.off_m < lag_m) == (options == 1.0)
    # and does not sink where it is not over it
    assert (landing.flight.vehicle.height_m < 2.5) == (options == 1.0)


def test_px4_never_gets_over_a_moving_pad() -> None:
    landing = TargetStation("px4", moving)
    landing.land(20.0)
    assert 0.4 < landing.off_m < 2.0
    assert landing.flight.vehicle.height_m > 3.5


def test_without_precision_landing_ardupilot_lands_where_it_is() -> None:
    landing = TargetStation("ardupilot", PLND_ENABLED=0.0)
    landing.land(20.0)
    assert landing.off_m > 0.6


def test_ardupilot_waits_for_a_lost_target_seeks_it_and_lands_in_the_end() -> None:
    landing = TargetStation("ardupilot", PLND_TIMEOUT=2.0, PLND_RET_MAX=1.0)
    landing.land(3.0)
    landing.visible = False
    landing.down(2.5)
    held = landing.flight.vehicle.height_m
    landing.down(1.0)
    assert landing.flight.vehicle.height_m == pytest.approx(held, abs=0.15)
    landing.down(25.0)
    assert any("Retrying" in text for text in landing.texts)
    assert not landing.flight.autopilot.armed


def test_px4_searches_higher_up_and_then_lands() -> None:
    landing = TargetStation("px4", PLD_SRCH_ALT=6.0, PLD_SRCH_TOUT=4.0, PLD_BTOUT=1.0)
    landing.visible = False
    landing.land(3.5)
    assert landing.flight.vehicle.height_m > 5.0
    assert landing.off_m > 0.6
    landing.visible = True
    landing.down(3.0)
    assert landing.off_m < 0.2  # it is approached
    landing.visible = False
    landing.down(60.0)
    assert not landing.flight.autopilot.armed


@pytest.mark.parametrize(
    ("autopilot_kind", "frame", "text"), [("px4", 12, "frame 12 unsupported"), ("ardupilot", 1, "Frame not")]
)
def test_frames_that_it_does_not_take_are_said_once(
    autopilot_kind: AutopilotKind, frame: int, text: str
) -> None:
    landing = TargetStation(autopilot_kind)
    landing.frame = frame
    landing.down(1.0)
    assert len([said for said in landing.texts if text in said]) == 1


@pytest.mark.parametrize("value", [math.nan, math.inf, -1e30])
def test_broken_targets_do_no_harm(autopilot_kind: AutopilotKind, value: float) -> None:
    landing = TargetStation(autopilot_kind)
    landing.land(0.0)
    for valid in (0, 1):
        broken = mavlink.MAVLink_landing_target_message(
            0, 0, landing.frame, value, value, value, 0, 0, value, value, value, (value,) * 4, 2, valid
        )
        landing.send(broken)
        landing.run(0.2)
    assert all(map(math.isfinite, landing.flight.vehicle.position))


def test_the_filter_finds_position_and_speed() -> None:
    rng = np.random.default_rng(4)
    axis = AxisFilter(3.0, 0.0, 0.01, 4.0)
    for step in range(400):
        axis.predict(0.01, 0.002, 1e-6)
        if step % 3 == 0:
            time_s = 0.01 * (step + 1)
            axis.fuse(3.0 + 0.7 * time_s - 0.1 * time_s * time_s + 0.05 * rng.standard_normal(), 0.0025)
    assert axis.velocity_m_s == pytest.approx(0.7 - 0.2 * 4.0, abs=0.03)
    assert axis.position_m == pytest.approx(3.0 + 2.8 - 1.6, abs=0.04)
    assert axis.surprise(axis.position_m + 1.0, 0.0025) > 100.0


def test_angles_are_to_the_right_and_backwards() -> None:
    direction = direction_from_angles((math.radians(10.0), math.radians(-20.0)))
    assert direction is not None
    assert direction[0] / direction[2] == pytest.approx(math.tan(math.radians(20.0)))
    assert direction[1] / direction[2] == pytest.approx(math.tan(math.radians(10.0)))
    assert direction_from_angles((1.6, 0.0)) is None
