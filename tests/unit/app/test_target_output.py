"""Which exposures become landing targets: each once, none without a sighting, none that is old or refused."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from companion.app.stages import OLDEST_TARGET_S, TargetOutput
from companion.base.geometry import IDENTITY
from companion.base.messages import AutopilotState, LandingTargetPose, PadSighting, PadState, VehicleState
from companion.config import ControlConfig
from companion.link.telemetry.poses import PoseHistory
from companion.pad import load_pad
from tests.unit.control.test_landing_target import pad_state

VEHICLE = cast(VehicleState, SimpleNamespace(aligned=True))


class Desk:
    """A `TargetOutput` with what it asks."""

    def __init__(self, kind: str = "ardupilot", **settings: Any) -> None:
        self.pad: PadState | None = pad_state()
        self.state = AutopilotState(time_s=0.0, connected=True, autopilot_kind=cast(Any, kind))
        self.poses: PoseHistory | None = PoseHistory()
        estimator = SimpleNamespace(pad=self._pad_at, attitude=lambda _: IDENTITY)
        config = ControlConfig(output="landing_target", **settings)
        self.output = TargetOutput(config, load_pad("moving_1300"), cast(Any, estimator), cast(Any, self))

    def _pad_at(self, time_s: float) -> PadState | None:
        return None if self.pad is None else replace(self.pad, time_s=time_s)

    def due(
        self, now_s: float, vehicle: VehicleState | None = VEHICLE, **seen: Any
    ) -> LandingTargetPose | None:
        return self.output.due(vehicle, self._pad_at(now_s), seen.get("sighting"), now_s)

    def sent(self, now_s: float, vehicle: VehicleState | None = VEHICLE, **seen: Any) -> LandingTargetPose:
        target = self.due(now_s, vehicle, **seen)
        assert target is not None
        return target

    def take_pose(self, time_s: float) -> None:
        assert self.poses is not None
        self.poses.take_position(time_s, (4.0, 5.0, -6.0))
        self.poses.take_attitude(time_s, IDENTITY)


def sighting(time_s: float) -> PadSighting:
    return PadSighting(
        time_s, 1, (0.5, -0.25, 4.0), IDENTITY, 1e-4 * np.eye(6), "F", (1,), {"F": 1}, 0.1
    )  # fmt: skip


def test_an_exposure_is_sent_once_with_its_own_time() -> None:
    desk = Desk()
    target = desk.sent(10.08)
    assert (target.time_s, target.position_ned_m) == (10.0, None)
    assert desk.due(10.11) is None
    desk.pad = pad_state(seen_time_s=10.1)
    assert desk.sent(10.15).time_s == 10.1


def test_a_pad_that_is_not_seen_is_silence() -> None:
    desk = Desk()
    assert desk.due(10.08) is not None
    # the filter carries the pad on for seconds; nothing of it is sent
    for now_s in np.arange(10.1, 20.0, 0.033):
        assert desk.due(float(now_s)) is None
    desk.pad = None
    assert desk.due(20.1) is None


def test_a_sighting_that_the_filter_has_refused_is_not_sent() -> None:
    desk = Desk()
    assert desk.due(10.05) is not None
    assert desk.due(10.1, sighting=sighting(10.06)) is None  # `seen_time_s` has stayed


def test_what_is_old_is_not_sent_any_more() -> None:
    assert Desk().due(10.0 + OLDEST_TARGET_S + 0.01) is None
    assert Desk().due(9.99) is None  # nor what is still to come


@pytest.mark.parametrize("vehicle", [None, cast(VehicleState, SimpleNamespace(aligned=False))])
def test_without_an_estimate_of_the_vehicle_it_is_as_one_frame_shows_it(vehicle: VehicleState | None) -> None:
    desk = Desk()
    assert desk.due(10.1, vehicle) is None
    target = desk.sent(10.1, vehicle, sighting=sighting(10.0))
    assert (target.time_s, target.position_body_m) == (10.0, (0.5, -0.25, 4.0))
    assert desk.due(10.13, vehicle, sighting=sighting(10.0)) is None


def test_px4_waits_for_its_own_pose_and_not_for_long() -> None:
    desk = Desk("px4")
    desk.take_pose(9.99)
    assert desk.due(10.05) is None
    desk.take_pose(10.03)
    assert desk.sent(10.08).position_ned_m == pytest.approx((6.0, 6.0, -1.0))
    late = Desk("px4")
    late.take_pose(9.99)
    late.take_pose(10.03)
    assert late.due(10.0 + OLDEST_TARGET_S + 0.05) is None


def test_nothing_goes_to_an_autopilot_that_is_lost_or_unknown() -> None:
    desk = Desk()
    known = desk.state
    for state in (replace(known, connected=False), replace(known, autopilot_kind=None)):
        desk.state = state
        assert desk.due(10.05) is None
    desk.state = known
    assert desk.due(10.06) is not None


def test_a_lead_moves_a_pad_that_drives_and_is_off_by_default() -> None:
    driving = pad_state(velocity_ned_m_s=(2.0, 0.0, 0.0))
    places = []
    for lead_s in (0.0, 1.0):
        desk = Desk("px4", target_lead_s=lead_s)
        desk.pad = driving
        desk.take_pose(9.99)
        desk.take_pose(10.03)
        position_ned_m = desk.sent(10.1).position_ned_m
        assert position_ned_m is not None
        places.append(position_ned_m[0])
    assert places == pytest.approx([6.0, 6.0 + 2.0 * 1.1])
    assert ControlConfig().target_lead_s == 0.0


def test_problems_are_those_of_this_output_alone() -> None:
    desk = Desk("px4")
    assert "LOCAL_POSITION_NED" in desk.output.problems(10.0)[0]
    desk.take_pose(10.0)
    assert desk.output.problems(10.1) == []
    assert Desk().output.problems(10.0) == []  # ArduPilot needs no pose
    desk.state = replace(desk.state, connected=False)
    assert desk.output.problems(10.1) == ["autopilot: no heartbeat"]
