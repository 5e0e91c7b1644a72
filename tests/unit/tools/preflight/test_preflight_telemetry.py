"""What is heard on the link, judged; and losses counted."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from companion.base.messages import AutopilotState, GpsFix, ImuSample, MagSample, RangeSample
from companion.config import CompanionConfig, validate
from companion.link.codec import CURRENT_MODE, Codec, mavlink
from companion.link.streams import POSE_RATES_HZ, telemetry_rates_hz
from companion.tools.preflight import autopilot
from companion.tools.preflight.findings import FindingState
from companion.tools.preflight.parameters import ParameterReadings
from companion.tools.preflight.telemetry import FrameCounter, Heard, judge

STATE = AutopilotState(
    time_s=0.0, connected=True, autopilot_kind="px4", mode="AUTO.LOITER", ready_to_arm=True, battery_share=0.9
)
WELL = Heard(
    state=STATE,
    refused=0,
    line=FrameCounter(),
    clock_settled=True,
    rates_hz=telemetry_rates_hz("px4"),
    samples_hz={ImuSample: 200.0, MagSample: 100.0, GpsFix: 5.0, RangeSample: 20.0},
    sensors_problem=None,
    parameters=ParameterReadings(1, {}, {}),
)


def found(heard: Heard, settings: dict[str, Any] | None = None) -> dict[str, FindingState]:
    """What is not well."""
    config = validate(CompanionConfig, settings or {}, "test")
    return {f.name: f.state for f in judge(heard, config) if f.state is not FindingState.OK}


def rates(changed: Mapping[int, float]) -> Heard:
    return replace(WELL, rates_hz={**WELL.rates_hz, **changed})


def test_a_good_link_is_well() -> None:
    assert found(WELL) == {}
    assert found(WELL, {"sense": {"source": "autopilot"}}) == {}


@pytest.mark.parametrize(
    ("connection", "hint"),
    [
        ("udpin:127.0.0.1:{port}", "nothing sends to this port"),
        ("udp:127.0.0.1:{port}", "nobody answers at this address"),
        ("serial:{line}:57600", "power, TX and RX crossed"),
    ],
)
def test_a_silent_link_has_the_hint_of_its_kind(
    connection: str, hint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(autopilot, "HEARTBEAT_PATIENCE_S", 0.1)
    ours, theirs = os.openpty()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        if connection.startswith("udpin"):
            free.close()
        line = connection.format(port=port, line=os.ttyname(theirs))
        config = validate(CompanionConfig, {"link": {"connection": line}}, "test")
        heartbeat, *others = asyncio.run(autopilot.check_link(config, None))
    os.close(ours)
    os.close(theirs)
    assert heartbeat.detail == f"{line}: no heartbeat within 0.1 s, not one byte"
    assert heartbeat.hint.startswith(hint)
    assert {finding.state for finding in others} == {FindingState.NOT_CHECKED}


def test_where_nothing_is_flown_neither_arming_nor_the_battery_matters_but_the_pose_does() -> None:
    tells = {"control": {"output": "landing_target"}}
    poor = replace(rates(POSE_RATES_HZ), state=replace(STATE, ready_to_arm=False, battery_share=0.05))
    assert found(poor, tells) == {}
    assert found(WELL, tells) == {"LOCAL_POSITION_NED": FindingState.FAIL}
    ardupilot = replace(STATE, autopilot_kind="ardupilot")  # it takes body axes
    needed = replace(WELL, state=ardupilot, rates_hz=telemetry_rates_hz("ardupilot"))
    assert found(needed, tells) == {}


@pytest.mark.parametrize(
    ("heard", "expected"),
    [
        (replace(WELL, state=replace(STATE, connected=False)), {"heartbeat": FindingState.FAIL}),
        (replace(WELL, state=replace(STATE, version=(1, 17, 0))), {}),
        (replace(WELL, state=replace(STATE, version=(1, 18, 0))), {"heartbeat": FindingState.WARNING}),
        (replace(WELL, state=replace(STATE, armed=True)), {"disarmed": FindingState.FAIL}),
        (replace(WELL, state=replace(STATE, ready_to_arm=False)), {"ready to arm": FindingState.WARNING}),
        (
            replace(WELL, state=replace(STATE, ready_to_arm=False, mode="OFFBOARD", offboard=True)),
            {"ready to arm": FindingState.WARNING},
        ),
        (replace(WELL, state=replace(STATE, ekf_ready=False)), {"ready to arm": FindingState.WARNING}),
        (replace(WELL, state=replace(STATE, battery_share=0.2)), {"battery": FindingState.FAIL}),
        (replace(WELL, state=replace(STATE, battery_share=None)), {"battery": FindingState.NOT_CHECKED}),
        (replace(WELL, clock_settled=False), {"clock": FindingState.WARNING}),
        (rates({mavlink.MAVLINK_MSG_ID_ATTITUDE: 10.0}), {"ATTITUDE": FindingState.WARNING}),
        (rates({mavlink.MAVLINK_MSG_ID_ATTITUDE: 0.0}), {"ATTITUDE": FindingState.FAIL}),
        # as PX4 does, which sends it when it changes
        (rates({CURRENT_MODE: 2.0}), {}),
        (rates({CURRENT_MODE: 0.5}), {"CURRENT_MODE": FindingState.WARNING}),
    ],
)
def test_each_fault_is_found_alone(heard: Heard, expected: dict[str, FindingState]) -> None:
    assert found(heard) == expected


def test_signing_is_wanted_where_others_reach_the_link() -> None:
    assert found(WELL, {"link": {"connection": "udpin:0.0.0.0:14540"}}) == {"signing": FindingState.WARNING}
    assert found(WELL, {"link": {"connection": "serial:/dev/ttyAMA2:921600"}}) == {}
    signed = {"link": {"signing_key": str(Path("key")), "actions": "pymavlink"}}
    assert found(WELL, signed) == {}
    assert found(replace(WELL, refused=3), signed) == {"signing": FindingState.WARNING}


def test_the_autopilot_s_sensors_are_judged_where_they_are_used() -> None:
    used = {"sense": {"source": "autopilot"}}
    silent = replace(WELL, sensors_problem="autopilot's sensors: no HIGHRES_IMU comes")
    assert found(silent) == {}
    assert found(silent, used) == {"telemetry": FindingState.FAIL}
    blind = replace(WELL, samples_hz={**WELL.samples_hz, GpsFix: 0.0, RangeSample: 0.0})
    assert found(blind, used) == {"GPS": FindingState.WARNING, "range": FindingState.WARNING}


# ---------------------------------------------------------------- losses

CODEC = Codec(1, 1)
FRAMES = [CODEC.encode(mavlink.MAVLink_timesync_message(0, number)) for number in range(300)]
UNKNOWN = bytearray(FRAMES[7])
UNKNOWN[7:10] = (0xEE, 0xEE, 0x0E)  # a message id of no dialect of ours


def counted(data: bytes, piece: int = 50) -> tuple[int, int, int]:
    counter = FrameCounter()
    for at in range(0, len(data), piece):
        counter.feed(data[at : at + piece])
    return counter.frames, counter.lost, counter.stray_bytes


def test_a_whole_stream_has_no_losses_whatever_its_dialect() -> None:
    # the last one is counted when the next begins
    assert counted(b"".join(FRAMES)) == (299, 0, 0)
    assert counted(b"".join((*FRAMES[:7], bytes(UNKNOWN), *FRAMES[8:]))) == (299, 0, 0)


def test_missing_frames_and_stray_bytes_are_counted() -> None:
    assert counted(b"".join(FRAMES[:10] + FRAMES[13:300])) == (296, 3, 0)
    frames, lost, stray = counted(b"xy" * 10 + b"".join(FRAMES[:10]) + FRAMES[10][:9] + b"".join(FRAMES[11:]))
    assert (lost, stray) == (1, 29)
    assert frames == 298


def test_a_line_that_loses_frames_is_reported() -> None:
    line = FrameCounter()
    line.feed(b"".join(FRAMES[:10] + FRAMES[30:60]))
    assert found(replace(WELL, line=line)) == {"losses": FindingState.WARNING}
