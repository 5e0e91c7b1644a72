"""The companion's own devices, each opened, looked at for a while and closed again: camera, IMU, GPS, echo.

Each check ends by itself, and what goes wrong with one is one finding of its own.
"""

import asyncio
import math
from collections.abc import Awaitable, Callable
from contextlib import closing, suppress
from dataclasses import replace
from statistics import median
from typing import Final

import numpy as np

from companion.base.clock import Clock
from companion.base.geometry import GRAVITY_M_S2, norm
from companion.base.messages import Frame, GpsFix, ImuSample, MagSample, RangeSample
from companion.config import CameraConfig, CompanionConfig, ConfigError
from companion.sense.camera.health import FrameJudge
from companion.sense.camera.keeper import LiveSource
from companion.sense.camera.reader import EndOfFrames, ReadBack
from companion.sense.camera.source import open_camera
from companion.sense.gps.neo6m import Neo6m
from companion.sense.imu.i2c import SensorError, open_bus
from companion.sense.imu.mpu9250 import IDENTITIES, WHO_AM_I, Mpu9250
from companion.sense.range.echo_pins import EchoPins
from companion.sense.range.range_finder import make_range_finder
from companion.sense.range.ultrasonic import RANGE_BAUD
from companion.sense.serial_port import SerialPort
from companion.tools.preflight.findings import Finding, FindingGroup

LOOK_S: Final = 3.0
FIRST_FRAME_S: Final = 5.0
GPS_TIMEOUT_S: Final = 12.0
ECHO_TIMEOUT_S: Final = 3.0
POLL_S: Final = 0.2
LEAST_RATE: Final = 0.9  # of the camera's rate
EXPOSURE_DIFFERS: Final = 0.2
DARK, BRIGHT = 20.0, 235.0  # mean grey of 255
CLIPPED_SHARE: Final = 0.3
AT_REST_M_S2: Final = 0.5  # |f| off gravity's, standing
LEVEL_DEG: Final = 15.0
EARTH_UT: Final = (20.0, 70.0)
GOOD_FIX_M: Final = 5.0
CAMERA_HINT: Final = "the cable, group video, no other program on it; the size is the calibration's"
IMU_HINT: Final = "sense.imu.bus; dtparam=i2c_arm=on (or spi=on) in config.txt, group i2c (spi)"
NO_NEO_HINT: Final = (
    "it serves, less well: expected a u-blox receiver (NEO-6M to M10) that takes its settings"
)
GPS_HINT: Final = "sense.gps.port: ls /dev/ttyAMA*; the UART in config.txt, group dialout"
RANGE_HINT: Final = "sense.range.kind and port (or pins): ls /dev/ttyAMA*; group dialout (gpio)"

_CAMERA, _IMU, _GPS, _RANGE = (
    FindingGroup("camera"),
    FindingGroup("IMU"),
    FindingGroup("GPS"),
    FindingGroup("range"),
)
_Check = Callable[[], Awaitable[list[Finding]]]


async def check_devices(config: CompanionConfig, camera: CameraConfig | None) -> list[Finding]:
    """All devices that the settings name, at once; `camera` is None when its file cannot be read."""
    sense = config.sense
    checks: list[tuple[FindingGroup, str, _Check]] = []
    if camera is not None:
        checks.append((_CAMERA, CAMERA_HINT, lambda: _camera(config, camera)))
    if sense.source == "boards":
        checks += [(_IMU, IMU_HINT, lambda: _imu(config)), (_GPS, GPS_HINT, lambda: _gps(config))]
    if not sense.range_by_telemetry:
        checks.append((_RANGE, RANGE_HINT, lambda: _range(config)))
    found = await asyncio.gather(*(_guarded(*check) for check in checks))
    skipped = [_CAMERA.skip("opens", "its file is not usable")] if camera is None else []
    return skipped + [finding for findings in found for finding in findings]


def without_devices(config: CompanionConfig, why: str, hint: str) -> list[Finding]:
    """The findings when the devices are not to be opened."""
    tellers = [_CAMERA, *((_IMU, _GPS) if config.sense.source == "boards" else ())]
    tellers += [] if config.sense.range_by_telemetry else [_RANGE]
    return [teller.skip("opens", why, hint) for teller in tellers]


async def _guarded(teller: FindingGroup, hint: str, check: _Check) -> list[Finding]:
    """A device that cannot be opened, or is lost, is a finding like others."""
    try:
        return await check()
    except (ConfigError, OSError) as error:
        return [teller.fail("opens", str(error), hint)]


# ---------------------------------------------------------------- camera


async def _camera(config: CompanionConfig, camera: CameraConfig) -> list[Finding]:
    vision = config.sense.vision
    with closing(await open_camera(vision.source, camera, vision.unstamped_latency_s)) as source:
        frames, judge, faults = list[Frame](), FrameJudge(oldest_s=math.inf), set[str]()
        try:
            async with asyncio.timeout(FIRST_FRAME_S):
                frames.append(await source.next())
            with suppress(TimeoutError):
                async with asyncio.timeout(LOOK_S):
                    while True:
                        frame = await source.next()
                        frames.append(frame)
                        if (fault := judge.fault(frame)) is not None:
                            faults.add(fault.text)
        except TimeoutError:
            return [
                _CAMERA.fail(
                    "frames",
                    f"{vision.shown_source}: none within {FIRST_FRAME_S:g} s",
                    "cable; another program",
                )
            ]
        except EndOfFrames:
            pass  # a short recording
        return _camera_findings(frames, faults, camera, source, vision.shown_source)


def _camera_findings(
    frames: list[Frame], faults: set[str], camera: CameraConfig, source: LiveSource, spec: str
) -> list[Finding]:
    found = [_frame_rate(frames, camera, spec), _exposure(source.read_back, camera), _picture(frames, faults)]
    notes = [_CAMERA.warn("driver", note, "docs/how-to/cameras.md") for note in source.take_notes()]
    if spec.startswith(("video:", "images:")):
        notes.append(
            _CAMERA.warn("source", f"{spec}: a recording", "sense.vision.source: the camera, to fly")
        )
    return found + notes


def _frame_rate(frames: list[Frame], camera: CameraConfig, spec: str) -> Finding:
    span_s = frames[-1].time_s - frames[0].time_s
    # by their numbers: who looks slowly misses frames that did come
    rate_hz = (frames[-1].sequence - frames[0].sequence) / span_s if span_s > 0.0 else 0.0
    age_s = median(frame.received_s - frame.time_s for frame in frames)
    size = f"{camera.width_px}x{camera.height_px}"
    detail = f"{spec}: {size}, {rate_hz:.1f} frames/s, {1e3 * age_s:.0f} ms old on arrival"
    if rate_hz >= LEAST_RATE * camera.rate_hz:
        return _CAMERA.ok("frames", detail)
    hint = "camera mode, USB bandwidth, pixel_format, exposure longer than a frame; docs/how-to/cameras.md"
    return _CAMERA.warn("frames", f"{detail}; expected {camera.rate_hz:g}", hint)


def _exposure(read_back: ReadBack, camera: CameraConfig) -> Finding:
    asked_ms = 1e3 * camera.exposure_s
    if read_back.exposure_s is None:
        return _CAMERA.skip("exposure", f"the source does not report it; exposure_s is {asked_ms:g} ms")
    detail = f"{read_back}; asked for {asked_ms:g} ms"
    if abs(read_back.exposure_s - camera.exposure_s) <= EXPOSURE_DIFFERS * camera.exposure_s:
        return _CAMERA.ok("exposure", detail)
    return _CAMERA.warn(
        "exposure", detail, "a longer one blurs what moves; the driver's automatic must be off"
    )


def _picture(frames: list[Frame], faults: set[str]) -> Finding:
    if faults:
        hint = "cable, driver, lens cap; docs/how-to/cameras.md"
        return _CAMERA.fail("picture", "; ".join(sorted(faults)), hint)
    image = frames[-1].image
    mean, clipped = float(image.mean()), float(np.mean(image >= 255))
    detail = f"mean grey {mean:.0f} of 255, {clipped:.0%} clipped"
    if mean < DARK:
        return _CAMERA.warn(
            "picture", f"{detail}: dark", "lens cap, light, gain; exposure_s in the camera's file"
        )
    if mean > BRIGHT or clipped > CLIPPED_SHARE:
        return _CAMERA.warn("picture", f"{detail}: overexposed", "a shorter exposure_s, or less gain")
    return _CAMERA.ok("picture", detail)


# ---------------------------------------------------------------- IMU


async def _imu(config: CompanionConfig) -> list[Finding]:
    imu, clock = config.sense.imu, Clock()
    with closing(open_bus(imu.bus)) as bus:
        where = f"{imu.bus}, 0x{imu.address:02x}"
        try:
            (identity,) = bus.read(imu.address, WHO_AM_I, 1)
        except OSError as error:
            hint = "wiring, 3.3 V, AD0 (sense.imu.address); i2cdetect -y"
            return [_IMU.fail("identity", f"{where}: {error.strerror or error}", hint)]
        if identity not in IDENTITIES:
            hint = "another chip: 0x70 is an MPU6500, without a magnetometer; 0x00 and 0xff: nothing answers"
            return [_IMU.fail("identity", f"{where}: 0x{identity:02x}; expected 0x71 or 0x73", hint)]
        driver, problems = Mpu9250(bus, imu), set[str]()
        inertial, fields = list[ImuSample](), list[MagSample]()
        until_s = clock.now_s() + LOOK_S
        while clock.now_s() < until_s:
            try:
                more, further = await asyncio.to_thread(driver.poll, clock.now_s)
                inertial += more
                fields += further
            except SensorError as error:
                problems.add(str(error))
            await asyncio.sleep(1.0 / imu.poll_hz)
        found = [_IMU.ok("identity", f"{IDENTITIES[identity]} at {where}")]
        return found + _inertial(inertial, problems, imu.rate_hz) + [_magnetometer(fields, driver.problem)]


def _inertial(samples: list[ImuSample], problems: set[str], rate_hz: float) -> list[Finding]:
    if problems or len(samples) < 2:
        said = "; ".join(sorted(problems)) or "no samples"
        return [_IMU.fail("samples", said, "wiring, supply; i2c_arm_baudrate=400000, sense.imu.read")]
    came_hz = (len(samples) - 1) / (samples[-1].time_s - samples[0].time_s)
    mean = np.mean([sample.specific_force_body_m_s2 for sample in samples], axis=0)
    size = float(np.linalg.norm(mean))
    tilt_deg = math.degrees(math.acos(max(-1.0, min(1.0, -float(mean[2]) / max(size, 1e-9)))))
    detail = f"|f| {size:.2f} m/s², {tilt_deg:.0f}° off level"
    rate = _IMU.ok("samples", f"{came_hz:.0f} Hz")
    if came_hz < LEAST_RATE * rate_hz:
        rate = _IMU.warn(
            "samples", f"{came_hz:.0f} Hz; expected {rate_hz:g}", "i2c_arm_baudrate=400000; sense.imu.read"
        )
    if abs(size - GRAVITY_M_S2) > AT_REST_M_S2:
        return [rate, _IMU.warn("at rest", detail, "keep it still; calibrate-mount accelerometer")]
    if tilt_deg > LEVEL_DEG:
        found = _IMU.warn("at rest", detail, "set it down level; else sense.imu.body_from_sensor_deg")
    else:
        found = _IMU.ok("at rest", detail)
    x, y, z = (-float(force) for force in mean)
    return [rate, replace(found, horizon_rad=(math.atan2(y, z), math.atan2(-x, math.hypot(y, z))))]


def _magnetometer(fields: list[MagSample], problem: str | None) -> Finding:
    if problem is not None or not fields:
        hint = "a clone without an AK8963, or the other sense.imu.mag_path"
        return _IMU.fail("magnetometer", problem or "no samples", hint)
    size_ut = median(norm(sample.field_body_ut) for sample in fields)
    detail = f"{size_ut:.0f} µT as it comes"
    if not EARTH_UT[0] <= size_ut <= EARTH_UT[1]:
        return _IMU.warn(
            "magnetometer", detail, f"expected {EARTH_UT[0]:g} to {EARTH_UT[1]:g}: iron or current nearby"
        )
    return _IMU.ok("magnetometer", detail)


# ---------------------------------------------------------------- GPS and echo


async def _gps(config: CompanionConfig) -> list[Finding]:
    gps, clock = config.sense.gps, Clock()
    receiver, fixes, early = Neo6m(gps), list[GpsFix](), list[GpsFix]()
    with closing(SerialPort(gps.port, gps.baud)) as port:
        until_s = clock.now_s() + GPS_TIMEOUT_S
        # fixes come before it has taken all settings; only then it shows what it can
        while clock.now_s() < until_s and len(fixes) < 2 * gps.rate_hz:
            question = receiver.pending(clock.now_s())
            port.set_baud(receiver.baud)
            port.write(question)
            with suppress(TimeoutError):
                async with asyncio.timeout(POLL_S):
                    came = receiver.feed(await port.read(), clock.now_s())
                    (fixes if receiver.configured else early).extend(came)
    if fixes or early:
        last = (fixes or early)[-1]
        place = (last.latitude_deg, last.longitude_deg, last.altitude_m)
        return [replace(_fix(fixes or early, receiver), place=place)]
    problem = receiver.problem or f"no fix within {GPS_TIMEOUT_S:g} s"
    if "no fix" in problem:
        return [_GPS.warn("fix", problem, "sky view; a cold start takes half a minute and more")]
    return [_GPS.fail("fix", f"{gps.port}: {problem}", "power, TX and RX crossed, sense.gps.port")]


def _fix(fixes: list[GpsFix], receiver: Neo6m) -> Finding:
    last = fixes[-1]
    detail = f"{receiver.name}: {last.satellites} satellites, {last.horizontal_accuracy_m:.1f} m"
    if last.horizontal_accuracy_m > GOOD_FIX_M:
        return _GPS.warn("fix", detail, f"expected {GOOD_FIX_M:g} m or better: sky view, and patience")
    if receiver.problem is not None:
        return _GPS.warn("fix", f"{receiver.problem} ({last.satellites} satellites)", NO_NEO_HINT)
    return _GPS.ok("fix", detail)


async def _range(config: CompanionConfig) -> list[Finding]:
    bounds, clock = config.sense.range, Clock()
    by_pins = bounds.kind == "gpio"
    opened: SerialPort | EchoPins = (
        EchoPins(bounds.trigger_pin, bounds.echo_pin, clock)
        if by_pins
        else SerialPort(bounds.port, RANGE_BAUD)
    )
    with closing(opened) as port:
        finder, samples = make_range_finder(bounds, port, clock), list[RangeSample]()
        until_s = clock.now_s() + ECHO_TIMEOUT_S
        finder.watch(clock.now_s())
        while clock.now_s() < until_s:
            with suppress(TimeoutError):
                async with asyncio.timeout(POLL_S):
                    samples += await finder.read()
        finder.watch(clock.now_s())
    where = f"pins {bounds.trigger_pin}, {bounds.echo_pin}" if by_pins else bounds.port
    if finder.problem is not None:
        return [_RANGE.fail("echo", f"{where}: {finder.problem}", "wiring, sense.range.kind, its supply")]
    if not samples:
        hint = f"it needs a surface within {bounds.floor_m:g} and {bounds.maximum_m:g} m, square to it"
        return [_RANGE.warn("echo", f"{where}: answers, and no distance to use", hint)]
    distance_m = median(sample.distance_m for sample in samples)
    return [_RANGE.ok("echo", f"{distance_m:.2f} m, {len(samples) / ECHO_TIMEOUT_S:.0f} a second")]
