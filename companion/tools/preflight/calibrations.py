"""The files that the settings name: whether they are there, fit one another, and are fresh."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final, TypeVar

from companion.app.sensing import load_used_magnetometer
from companion.base.files import shipped_file
from companion.config import (
    CONFIG_FOLDER,
    CameraConfig,
    CompanionConfig,
    ConfigError,
    VehicleConfig,
    find_file,
    load_inertial,
    load_model,
    load_mount,
    load_vehicle,
)
from companion.config.calibration import Provenance
from companion.pad import load_pad
from companion.tools.preflight.findings import Finding, FindingGroup

OLDEST: Final = timedelta(days=365)
OLDEST_COMPASS: Final = timedelta(days=180)  # whatever is bolted on near it changes it
T = TypeVar("T")
_SETTINGS, _GROUP = FindingGroup("settings"), FindingGroup("calibration")


def check_files(
    config: CompanionConfig, path: Path, now: datetime
) -> tuple[CameraConfig | None, VehicleConfig | None, list[Finding]]:
    """Camera and vehicle as far as they can be read, and findings about the files; `now` in UTC."""
    found = [_SETTINGS.ok("file", str(path))]
    camera = _read(found, "camera", lambda: load_model(CameraConfig, find_file("cameras", config.camera)))
    vehicle = _read(found, "vehicle", lambda: load_vehicle(config.vehicle, config.mount, config.camera))
    _read(found, "pad", lambda: load_pad(config.pad))
    if vehicle is not None:
        found.append(_vehicle(config, vehicle))
    if camera is not None:
        found.append(_camera(config, camera, now))
        found.append(_mount(config, camera, now))
    if config.sense.source == "boards":
        found.append(_inertial(config, now))
    found.append(_magnetometer(config, now))
    return camera, vehicle, found


def _read(found: list[Finding], name: str, load: Callable[[], T]) -> T | None:
    """What `load` gives, or None with a finding that says why not."""
    try:
        return load()
    except ConfigError as error:
        found.append(_SETTINGS.fail(name, str(error), f"see '{name}' in the settings"))
        return None


def _vehicle(config: CompanionConfig, vehicle: VehicleConfig) -> Finding:
    shipped = (CONFIG_FOLDER / "vehicles" / f"{config.vehicle}.yaml").is_file()
    if shipped:
        copied = shipped_file(f"vehicles/{config.vehicle}.yaml")
        hint = f"measure your own into a copy of {copied} beside the settings, and name that there"
        return _SETTINGS.warn("vehicle", f"'{vehicle.name}', a shipped example", hint)
    return _SETTINGS.ok("vehicle", f"'{vehicle.name}', hover thrust {vehicle.hover_thrust:g}")


def _camera(config: CompanionConfig, camera: CameraConfig, now: datetime) -> Finding:
    made, size = camera.calibration, f"{camera.width_px}x{camera.height_px}"
    if made is None:
        hint = "calibrate-camera: heights and the touchdown are off by as much as its numbers are"
        return _GROUP.warn("camera", f"'{camera.name}' {size}: not written by calibrate-camera", hint)
    detail = f"'{camera.name}' {size}, {made.rms_px:.2f} px, {_date(made.provenance)}"
    source, used = made.provenance.source, config.sense.vision.shown_source
    if not made.verdict and _is_device(source) and _is_device(used) and source != used:
        return _GROUP.warn(
            "camera",
            f"{detail}: taken with {source}, sense.vision.source is {used}",
            "is it the same camera?",
        )
    return _judged("camera", detail, made.verdict, made.provenance, now, "calibrate-camera")


def _mount(config: CompanionConfig, camera: CameraConfig, now: datetime) -> Finding:
    try:
        made = load_mount(config.mount, config.camera)
    except ConfigError as error:
        return _GROUP.fail("mount", str(error), "calibrate-mount camera, with the camera's present file")
    if made is None:
        hint = "calibrate-mount record and camera; till then the vehicle's file has the camera's angles"
        return _GROUP.warn("mount", "none named ('mount')", hint)
    offset_ms = 1e3 * made.time_offset_s
    detail = f"yaw {made.camera_yaw_deg:.1f}°, stamps {offset_ms:+.0f} ms, {_date(made.provenance)}"
    if not made.forced and camera.calibration is not None:
        mounted, calibrated = _when(made.provenance), _when(camera.calibration.provenance)
        if mounted is not None and calibrated is not None and mounted < calibrated:
            hint = "calibrate-mount camera again: it was found with the camera's former numbers"
            return _GROUP.warn("mount", f"{detail}: older than the camera's calibration", hint)
    return _judged("mount", detail, made.forced, made.provenance, now, "calibrate-mount camera")


def _inertial(config: CompanionConfig, now: datetime) -> Finding:
    try:
        made = load_inertial(config.sense)
    except ConfigError as error:
        return _GROUP.fail("inertial", str(error), "calibrate-mount accelerometer")
    if made is None:
        hint = "calibrate-mount accelerometer, then sense.imu.inertial_calibration"
        return _GROUP.warn("inertial", "none named (sense.imu.inertial_calibration)", hint)
    detail = f"{made.provenance.source}, {_date(made.provenance)}"
    return _judged("inertial", detail, made.forced, made.provenance, now, "calibrate-mount accelerometer")


def _magnetometer(config: CompanionConfig, now: datetime) -> Finding:
    try:
        made = load_used_magnetometer(config.sense)
    except ConfigError as error:
        return _GROUP.fail("magnetometer", str(error), "calibrate-magnetometer")
    if made is None:
        if config.sense.source == "autopilot":
            return _GROUP.ok("magnetometer", "the autopilot's own")
        hint = "calibrate-magnetometer, then sense.imu.magnetometer_calibration; else the heading drifts"
        return _GROUP.warn("magnetometer", "none named (sense.imu.magnetometer_calibration)", hint)
    detail = f"{made.quality.verdict}, {_date(made.provenance)}"
    against = (made.quality.reasons or ("",)) if made.quality.verdict == "refused" else ()
    return _judged(
        "magnetometer", detail, against, made.provenance, now, "calibrate-magnetometer", OLDEST_COMPASS
    )


# ---------------------------------------------------------------- what they have in common


def _judged(
    name: str,
    detail: str,
    forced: tuple[str, ...],
    made: Provenance,
    now: datetime,
    tool: str,
    oldest: timedelta = OLDEST,
) -> Finding:
    """Was it written by force (against these reasons), and how old is it?"""
    when = _when(made)
    if forced:
        return _GROUP.warn(name, f"{detail}: written by force: {'; '.join(forced)}", f"{tool} again")
    if when is None:
        return _GROUP.warn(name, f"{detail}: without a date", f"{tool} again")
    if when > now + timedelta(days=1):
        return _GROUP.warn(name, f"{detail}: in the future", "the clock is wrong, now or when it was made")
    if now - when > oldest:
        return _GROUP.warn(
            name, f"{detail}: {(now - when).days} days old", f"{tool} again, at the latest after a crash"
        )
    return _GROUP.ok(name, detail)


def _when(made: Provenance) -> datetime | None:
    try:
        when = datetime.fromisoformat(made.date)
    except ValueError:
        return None
    return when if when.tzinfo is not None else when.replace(tzinfo=UTC)


def _date(made: Provenance) -> str:
    return made.date[:10]


def _is_device(source: str) -> bool:
    return source.startswith(("v4l2:", "picamera2:"))
