"""What was heard of the autopilot in a few seconds, judged. Pure.

Which messages did not arrive is known by their sequence numbers, whatever dialect they are of: the app's
codec knows one dialect and passes over what is none of it as if it were noise, so that an autopilot that
sends messages of a newer one would look like a bad line. Here a frame is what its header says it is, provided
that another one follows it.
"""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from companion.base.autopilots import PROFILES, version_text
from companion.base.geometry import euler_from_quat
from companion.base.messages import AutopilotState, GpsFix, ImuSample, MagSample, RangeSample
from companion.config import CompanionConfig
from companion.link.codec import (
    AUTOPILOT_COMPONENT,
    CURRENT_MODE,
    MARKER,
    frame_length,
    mavlink,
    message_id_of,
)
from companion.link.signing import V2_MARKER
from companion.link.streams import pose_rates_hz, telemetry_rates_hz
from companion.plan.mission.readiness import offboard_words
from companion.tools.preflight.findings import Finding, FindingGroup
from companion.tools.preflight.parameters import ParameterReadings


class FrameCounter:
    """Counts frames, the autopilot's by their messages' ids, gaps in the sequences, and bytes of no frame."""

    def __init__(self) -> None:
        self.frames = self.lost = self.stray_bytes = 0
        self.messages: Counter[int] = Counter()
        self._buffer = bytearray()
        self._sequences: dict[tuple[int, int], int] = {}

    def feed(self, data: bytes) -> None:
        buffer = self._buffer
        buffer += data
        start = 0
        while (marker := MARKER.search(buffer, start)) is not None:
            self.stray_bytes += marker.start() - start
            start = marker.start()
            if len(buffer) - start < 3 or len(buffer) - start <= (size := frame_length(buffer, start)):
                break
            if MARKER.match(buffer, start + size) is None:
                self.stray_bytes += 1
                size = 1
            else:
                self._count(buffer, start)
            start += size
        else:
            self.stray_bytes += len(buffer) - start
            start = len(buffer)
        del buffer[:start]

    def _count(self, buffer: bytearray, start: int) -> None:
        at = start + (4 if buffer[start] == V2_MARKER else 2)
        sequence, source = buffer[at], (buffer[at + 1], buffer[at + 2])
        if source[1] == AUTOPILOT_COMPONENT:
            self.messages[message_id_of(buffer, start)] += 1
        last = self._sequences.get(source)
        self._sequences[source] = sequence
        self.frames += 1
        if last is not None:
            self.lost += (sequence - last - 1) % 256


# ---------------------------------------------------------------- what was heard

HONOURED_SHARE: Final = 0.6  # of a rate asked for
# PX4 sends its mode when it changes and twice a second, whatever is asked for (CURRENT_MODE.hpp)
ON_CHANGE_HZ: Final = {CURRENT_MODE: 2.0}
LOST_SHARE: Final = 0.02
_LINK: Final = FindingGroup("link")
_TELEMETRY: Final = FindingGroup("telemetry")
_SENSORS: Final = FindingGroup("autopilot's sensors")
_LOCAL: Final = ("serial:", "udp:127.", "udpin:127.", "tcp:127.", "udp:localhost", "tcp:localhost")
_RATE_HINT: Final = (
    "a faster baud rate, or a higher MAV_x_RATE with MAV_x_MODE Onboard (PX4), SRx_ (ArduPilot); "
    "another program on this link may ask for another rate"
)


@dataclass(frozen=True, slots=True)
class Heard:
    """The link after a while: rates (Hz) by message id and by kind of sample, parameters."""

    state: AutopilotState
    refused: int  # frames without a right signature
    line: FrameCounter
    clock_settled: bool
    rates_hz: Mapping[int, float]
    samples_hz: Mapping[type, float]
    sensors_problem: str | None
    parameters: ParameterReadings


def judge(heard: Heard, config: CompanionConfig) -> list[Finding]:
    """Everything but the parameters."""
    found = [_heartbeat(heard), _disarmed(heard.state), *_attitude(heard.state)]
    if config.control.output == "setpoints":  # the app flies
        found += [replace(_ready(heard.state), place=heard.state.home), _battery(heard.state, config)]
    found += [
        _signing(heard.refused, config),
        _losses(heard.line),
        _clock(clock_settled=heard.clock_settled),
        *_rates(heard, config),
    ]
    if config.sense.source == "autopilot":
        found += _sensors(heard, config)
    return found


def _heartbeat(heard: Heard) -> Finding:
    kind, state = heard.state.autopilot_kind, heard.state
    if not state.connected:
        return _LINK.fail(
            "heartbeat", "came, and then stayed away", "wiring; the autopilot may have restarted"
        )
    if kind is None:
        return _LINK.fail("heartbeat", "of an unknown autopilot", "expected PX4 or ArduPilot")
    rate_hz = heard.rates_hz.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT, 0.0)
    profile = PROFILES[kind]
    version = "" if state.version is None else f" {version_text(state.version)}"
    words = f"{profile.title}{version}, mode {state.mode or 'unknown'}, {rate_hz:.1f} Hz"
    if unflown := profile.unflown(state.version):
        return _LINK.warn("heartbeat", words, f"{unflown}; try it in its own simulator first")
    return _LINK.ok("heartbeat", words)


def _disarmed(state: AutopilotState) -> Finding:
    if state.armed:
        return _LINK.fail("disarmed", "the autopilot says armed", "disarm it: this is a check on the ground")
    return _LINK.ok("disarmed", "disarmed")


def _ready(state: AutopilotState) -> Finding:
    if state.ready_to_arm and state.ekf_ready is not False:
        return _LINK.ok("ready to arm", "the autopilot's own checks pass")
    checks = f"its own checks do not pass{offboard_words(state)}"
    why = "its filter has no position yet" if state.ready_to_arm else checks
    said = f": {'; '.join(state.texts[-2:])}" if state.texts else ""
    return _LINK.warn(
        "ready to arm", f"{why}{said}", "indoors that is GPS; else see the ground station's messages"
    )


def _attitude(state: AutopilotState) -> list[Finding]:
    if state.attitude is None:
        return []
    roll, pitch, yaw = euler_from_quat(state.attitude)
    words = (
        f"roll {math.degrees(roll):.1f}°, pitch {math.degrees(pitch):.1f}°, "
        f"heading {math.degrees(yaw) % 360.0:.0f}°"
    )
    return [replace(_LINK.ok("attitude", words), horizon_rad=(roll, pitch))]


def _battery(state: AutopilotState, config: CompanionConfig) -> Finding:
    share, bounds = state.battery_share, config.plan.mission.battery
    if share is None:
        hint = "without it the app cannot refuse a flight on a low battery (BAT1_SOURCE, BATT_MONITOR)"
        return _LINK.skip("battery", "the autopilot reports none", hint)
    if share < bounds.low:
        hint = f"charge it: below {bounds.low:.0%} (plan.mission.battery.low) the app does not take off"
        return _LINK.fail("battery", f"{share:.0%}", hint)
    return _LINK.ok("battery", f"{share:.0%}")


def _signing(refused: int, config: CompanionConfig) -> Finding:
    if config.link.signing_key is not None:
        if refused:
            return _LINK.warn(
                "signing",
                f"on; {refused} frames without a right signature refused",
                "somebody on the link does not sign, or with another key",
            )
        return _LINK.ok("signing", f"on, by {config.link.signing_key}")
    if config.link.connection.startswith(_LOCAL):
        return _LINK.ok("signing", "off, on a line of this vehicle's own")
    return _LINK.warn(
        "signing",
        f"off on {config.link.connection}",
        "whoever reaches this network can command the vehicle: link.signing_key",
    )


def _losses(line: FrameCounter) -> Finding:
    sent = line.lost + line.frames
    share = line.lost / max(1, sent)
    detail = f"{line.lost} of {sent} messages lost, {line.stray_bytes} bytes of none"
    if share > LOST_SHARE:
        return _LINK.warn(
            "losses", detail, "ground wire, cable length, baud rate; flow control on telemetry ports"
        )
    return _LINK.ok("losses", detail)


def _clock(*, clock_settled: bool) -> Finding:
    if clock_settled:
        return _LINK.ok("clock", "answers TIMESYNC")
    return _LINK.warn(
        "clock", "no answers to TIMESYNC", "its samples are stamped on arrival; a busy or one-way line"
    )


def _rates(heard: Heard, config: CompanionConfig) -> list[Finding]:
    """One line when all is well, else one for each message that comes too seldom."""
    wanted = telemetry_rates_hz(heard.state.autopilot_kind)
    if config.control.output == "landing_target":
        wanted |= pose_rates_hz(heard.state.autopilot_kind)
    slow, well = list[Finding](), list[str]()
    for number, asked_hz in wanted.items():
        name, rate_hz = mavlink.mavlink_map[number].msgname, heard.rates_hz.get(number, 0.0)
        if rate_hz >= HONOURED_SHARE * ON_CHANGE_HZ.get(number, asked_hz):
            well.append(f"{name} {rate_hz:.0f}")
        elif rate_hz == 0.0:
            slow.append(_TELEMETRY.fail(name, f"does not come; asked for {asked_hz:g} Hz", _RATE_HINT))
        else:
            detail = f"{rate_hz:.1f} Hz; asked for {asked_hz:g}"
            slow.append(_TELEMETRY.warn(name, detail, _RATE_HINT))
    return [*slow, _TELEMETRY.ok("rates", f"{', '.join(well)} Hz")] if well else slow


def _sensors(heard: Heard, config: CompanionConfig) -> list[Finding]:
    hint = "docs/how-to/telemetry-sensors.md: stream rates and baud rate"
    if heard.sensors_problem is not None:
        return [_SENSORS.fail("telemetry", heard.sensors_problem.partition(": ")[2], hint)]
    imu_hz, field_hz = heard.samples_hz[ImuSample], heard.samples_hz[MagSample]
    found = [_SENSORS.ok("IMU and compass", f"IMU {imu_hz:.0f} Hz, compass {field_hz:.0f} Hz")]
    fixes_hz = heard.samples_hz[GpsFix]
    if fixes_hz > 0.0:
        found.append(_SENSORS.ok("GPS", f"{fixes_hz:.1f} fixes/s"))
    else:
        found.append(_SENSORS.warn("GPS", "no fix that can be used", "sky view; the start waits for it"))
    if config.sense.range_by_telemetry:
        echoes_hz = heard.samples_hz[RangeSample]
        detail = f"{echoes_hz:.0f} distances/s"
        hint = "it must look down, and the ground be within sense.range.minimum_m and maximum_m"
        found.append(
            _SENSORS.ok("range", detail) if echoes_hz else _SENSORS.warn("range", "none to use", hint)
        )
    return found
