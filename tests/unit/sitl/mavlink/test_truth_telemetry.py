"""The truth as real simulators tell it: as it is, when asked for, and only from one that serves it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import ned_from_geodetic, quat_from_euler
from companion.config import LinkConfig, SenseConfig
from companion.link.codec import Codec, command_long
from companion.link.session import Session
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.external import pose as external_pose
from sitl.mavlink.endpoint import MavlinkEndpoint
from sitl.mavlink.sensor_telemetry import HIL_STATE, SIM_STATE, TruthMessages
from sitl.scenario.home import USUAL_HOMES
from sitl.scenario.scenario import Scenario
from sitl.vehicle.quadrotor import QuadrotorState
from sitl.world.world import World

HOME = USUAL_HOMES["px4"]

AUTOPILOT_KINDS: tuple[AutopilotKind, ...] = ("px4", "ardupilot")
OF = {"px4": HIL_STATE, "ardupilot": SIM_STATE}
STATE = QuadrotorState(
    (3.0, -4.0, -5.0), (0.5, 0.25, -1.0), quat_from_euler(0.1, -0.2, 2.5), (0.1, -0.2, 0.3)
)


def endpoint(autopilot_kind: AutopilotKind, *, serving: bool) -> MavlinkEndpoint:
    world = World(Scenario(name="t", description="t", autopilot=autopilot_kind), 0)
    world.place(STATE)
    autopilot = SimulatedAutopilot(autopilot_kind, world.airframe.body, np.random.default_rng(0), HOME)
    return MavlinkEndpoint(autopilot, truth=TruthMessages(autopilot, world, HOME) if serving else None)


def heard(port: MavlinkEndpoint, *requests: Any, seconds: float = 1.0) -> list[Any]:
    """What it sends in that time after these requests."""
    client, listener, messages = Codec(1, 26), Codec(0), []
    for request in requests:
        port.receive(client.encode(request), 0.0)
    for k in range(round(seconds / 0.005)):
        messages += listener.decode(port.transmit(0.005 * k))
    return messages


def interval(message_id: int, rate_hz: float) -> Any:
    return command_long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (message_id, 1e6 / rate_hz, 0, 0, 0, 0, 0), 1)


@pytest.mark.parametrize("autopilot_kind", AUTOPILOT_KINDS)
def test_it_is_the_truth_at_the_rate_asked_for(autopilot_kind: AutopilotKind) -> None:
    told = [m for m in heard(endpoint(autopilot_kind, serving=True), interval(OF[autopilot_kind], 100.0))
            if m.get_msgId() == OF[autopilot_kind]]  # fmt: skip
    assert len(told) == pytest.approx(100, abs=2)
    read = external_pose.hil_state if autopilot_kind == "px4" else external_pose.sim_state
    sample = read(told[-1], 0.0)
    assert sample is not None
    assert ned_from_geodetic(*sample.place, HOME) == pytest.approx(STATE.position_ned_m, abs=0.012)
    assert sample.velocity_ned_m_s == pytest.approx(STATE.velocity_ned_m_s, abs=0.01)
    assert sample.attitude == pytest.approx(STATE.attitude, abs=1e-6)
    assert sample.rate_body_rad_s == pytest.approx(STATE.rate_body_rad_s, abs=1e-6)


@pytest.mark.parametrize("autopilot_kind", AUTOPILOT_KINDS)
def test_nobody_gets_it_unasked_nor_from_a_simulator_that_does_not_serve_it(
    autopilot_kind: AutopilotKind,
) -> None:
    truths = {SIM_STATE, HIL_STATE}
    assert not truths & {m.get_msgId() for m in heard(endpoint(autopilot_kind, serving=True))}
    asked = [interval(number, 100.0) for number in truths]
    refused = heard(endpoint(autopilot_kind, serving=False), *asked)
    assert not truths & {m.get_msgId() for m in refused}
    results = [m.result for m in refused if m.get_type() == "COMMAND_ACK"]
    assert len(results) == 2
    assert mavlink.MAV_RESULT_ACCEPTED not in results


@pytest.mark.parametrize("autopilot_kind", AUTOPILOT_KINDS)
def test_the_app_never_asks_for_it_nor_hears_it(autopilot_kind: AutopilotKind) -> None:
    """A minute of the app's session, with the autopilot's own sensors, against a simulator that serves it."""
    port = endpoint(autopilot_kind, serving=True)
    session = Session(LinkConfig(), SenseConfig(source="autopilot"))
    listener, asked = Codec(0), set()
    for k in range(1200):
        now_s = 0.05 * k
        session.receive(port.transmit(now_s), now_s)
        out = session.tick(now_s)
        asked |= {
            round(m.param1)
            for m in listener.decode(out)
            if m.get_type() in ("COMMAND_LONG", "COMMAND_INT") and m.command in (511, 512)
        }
        port.receive(out, now_s)
    assert {mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_HOME_POSITION} & asked
    assert not {SIM_STATE, HIL_STATE, 164} & asked  # 164: ArduPilot's SIMSTATE
    # one that another client has asked for is not listened to
    before = session.counters.decoded
    port.receive(Codec(1, 26).encode(interval(OF[autopilot_kind], 100.0)), 60.0)
    session.receive(bytes(port._pack(port._truth.build(OF[autopilot_kind], 60.0))), 60.0)  # type: ignore[union-attr]
    assert session.counters.decoded == before
