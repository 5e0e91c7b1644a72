"""What the running service says of itself and its machine: `companion status` shows it, as text or JSON."""

import math
import os
import resource
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict

from companion.app.app import App
from companion.app.service.systemd import throttled_bits
from companion.base.messages import InputUse, Notice
from companion.base.second_sources import SourceState, judged
from companion.flightlog.meter import Meter, Rate
from companion.flightlog.record import FlightLog
from companion.link.codec import Message, computer_status

# ---------------------------------------------------------------- the machine

_THERMAL: Final = Path("/sys/class/thermal/thermal_zone0/temp")  # 0.001 deg C
_CLOCK: Final = Path("/sys/devices/system/cpu/cpu0/cpufreq")  # files in kHz
_MEGABYTE: Final = 1e6
# bits of `vcgencmd get_throttled` that hold now (Raspberry Pi documentation)
_THROTTLED: Final = {0: "under-voltage", 1: "frequency capped", 2: "throttled", 3: "soft temperature limit"}


@dataclass(frozen=True, slots=True, kw_only=True)
class ComputerStatus:
    """`cpu_percent` of one core, since the last time it was asked; None: not known here.

    `clock_mhz` is the processor's clock frequency now, `full_clock_mhz` the most that it may be.
    """

    cpu_percent: float | None = None
    memory_mb: float
    temperature_deg_c: float | None = None
    clock_mhz: float | None = None
    full_clock_mhz: float | None = None
    throttled: tuple[str, ...] | None = None
    disk_free_mb: float | None = None


class ComputerWatch:
    """Call `state` now and then; the CPU's share is that of the time between."""

    def __init__(self, now_s: float) -> None:
        self._asked_s, self._used_s = now_s, _cpu_s()

    def state(
        self, now_s: float, folder: Path | None, held_back: tuple[str, ...] | None = None
    ) -> ComputerStatus:
        """The state now; `folder` is where flights are recorded, `held_back` what `throttled` gave."""
        used_s, elapsed_s = _cpu_s(), now_s - self._asked_s
        share = 100.0 * (used_s - self._used_s) / elapsed_s if elapsed_s > 0.5 else None
        if share is not None:
            self._asked_s, self._used_s = now_s, used_s
        return ComputerStatus(
            cpu_percent=share,
            memory_mb=_memory_mb(),
            temperature_deg_c=_thousandth(_THERMAL),
            clock_mhz=_thousandth(_CLOCK / "scaling_cur_freq"),
            full_clock_mhz=_thousandth(_CLOCK / "cpuinfo_max_freq"),
            throttled=held_back,
            disk_free_mb=None if folder is None else _disk_mb(folder)[0],
        )


def ground_report(status: ComputerStatus, folder: Path | None, unix_s: float, up_s: float) -> Message:
    """The same for a ground station: the app's own share of the whole processor, its memory, the disk."""
    cores, share = os.cpu_count() or 1, status.cpu_percent
    total_mb = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / _MEGABYTE
    free_mb, disk_mb = status.disk_free_mb, 0.0 if folder is None else _disk_mb(folder)[1]
    return computer_status(
        round(1e6 * unix_s),
        round(1e3 * up_s) % 2**32,
        None if share is None else share / cores,
        status.temperature_deg_c,
        (status.memory_mb, total_mb),
        (disk_mb - free_mb, disk_mb) if disk_mb and free_mb is not None else None,
    )


def throttled() -> tuple[str, ...] | None:
    """What holds the Raspberry Pi's processor back now; None on another machine. Takes some milliseconds."""
    bits = throttled_bits()
    return None if bits is None else tuple(words for bit, words in _THROTTLED.items() if bits >> bit & 1)


def _cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def _memory_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


def _thousandth(file: Path) -> float | None:
    """A thousandth of the number in a file of the kernel's; None where there is none."""
    try:
        return int(file.read_text(encoding="ascii")) / 1000.0
    except (OSError, ValueError):
        return None


def _disk_mb(folder: Path) -> tuple[float, float]:
    """What is free of the disk that a folder is or will be on, and its size; one that fails has no room."""
    try:
        usage = shutil.disk_usage(next(place for place in (folder, *folder.parents) if place.exists()))
    except (OSError, StopIteration):
        return 0.0, 0.0
    return usage.free / _MEGABYTE, usage.total / _MEGABYTE


# the log's topics that are inputs, and how old the newest may be before something is wrong (s)
INPUTS: Final = {
    "imu": ("IMU", 0.5),
    "mag": ("magnetometer", 2.0),
    "gps": ("GPS", 2.5),
    "range": ("ultrasonic", math.inf),  # no echo from high up is no fault
    "frame_report": ("camera", 1.0),
}
UNUSED_IN_A_ROW: Final = 10
LATE_SHARE: Final = 0.05
LEAST_DISK_MB: Final = 200.0
SHOWN_EVENTS: Final = 8


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True)


class InputReport(_Model):
    """One input; `silent`: for longer than it may be.

    `used` and `refused` count what the estimator has done with it; `unused`: it has come and been refused
    for so many in a row that it is no help now, for the last `reason`.
    """

    name: str
    rate_hz: float
    age_s: float
    silent: bool
    used: int = 0
    refused: int = 0
    unused: bool = False
    reason: str = ""


class SourceReport(_Model):
    """A quantity by two sources, as the table of second sources judges it; `words` has both figures."""

    quantity: str
    state: SourceState
    words: str


class LatencyReport(_Model):
    """From exposure (ms)."""

    p50_ms: float
    p99_ms: float


class Event(_Model):
    """A notice; `time_s` counts from the app's start."""

    time_s: float
    severity: str
    text: str


class StateReport(_Model):
    """The whole; `problems` is what keeps it from landing now, or will; none: healthy."""

    phase: str
    order: str | None
    up_s: float
    autopilot: str | None
    mode: str
    armed: bool
    battery_percent: float | None
    inputs: tuple[InputReport, ...]
    aligned: bool
    estimate_problem: str | None = None
    vision_only: bool = False  # it flies nothing, and needs the camera and the autopilot alone
    attitude_std_deg: float | None
    velocity_std_m_s: float | None
    position_std_m: float | None
    pad_seen_s: float | None
    pad_lateral_m: float | None
    pad_height_m: float | None
    sources: tuple[SourceReport, ...]
    latency: dict[str, LatencyReport]
    late_cycles_percent: float
    machine: ComputerStatus
    recording: str | None
    events: tuple[Event, ...]
    problems: tuple[str, ...]

    @property
    def words(self) -> str:
        if self.order is not None:
            head = f"{self.phase.replace('_', ' ')}, {self.order}"
        elif self.vision_only:
            head = "does not send the pad" if self.problems else "sends the pad when it is seen"
        else:
            head = "not ready to land" if self.problems else "ready to land"
        return ": ".join((head, "; ".join(self.problems))) if self.problems else head


def state_report(
    app: App, meter: Meter, machine: ComputerStatus, log: FlightLog, now_s: float, start_s: float
) -> StateReport:
    """The app's state now; times are the loop's (s)."""
    folder = log.flight_folder
    autopilot, vehicle, pad = app.session.state, app.estimator.vehicle(now_s), app.estimator.pad(now_s)
    rates, order = meter.rates(now_s), app.missions.order
    uses = {use.name: use for use in app.estimator.tally.uses()}
    share = autopilot.battery_share
    return StateReport(
        phase=app.phase.value,
        order=None if order is None else f"{order.kind} by {order.source}",
        up_s=now_s - start_s,
        autopilot=autopilot.autopilot_kind if autopilot.connected else None,
        mode=autopilot.mode,
        armed=autopilot.armed,
        battery_percent=None if share is None else 100.0 * share,
        inputs=tuple(
            InputReport(
                name=name,
                rate_hz=rates[topic].rate_hz,
                age_s=rates[topic].age_s,
                silent=rates[topic].age_s > oldest_s,
                **_use(uses.get(topic)),
            )
            for topic, (name, oldest_s) in _inputs(app)
            if topic in rates
        ),
        aligned=vehicle is not None and vehicle.aligned,
        estimate_problem=None if app.vision_only else app.missions.estimate_problem(now_s),
        vision_only=app.vision_only,
        attitude_std_deg=None if vehicle is None else math.degrees(vehicle.attitude_std_rad),
        velocity_std_m_s=None if vehicle is None else vehicle.velocity_std_m_s,
        position_std_m=None if vehicle is None else vehicle.position_std_m,
        pad_seen_s=None if pad is None else now_s - pad.seen_time_s,
        pad_lateral_m=None if pad is None else pad.lateral_m,
        pad_height_m=None if pad is None else pad.height_m,
        sources=tuple(
            SourceReport(quantity=row.quantity, state=state, words=words)
            for row, state, words in judged(app.sources.comparisons(now_s))
        ),
        latency={
            name: LatencyReport(p50_ms=p50, p99_ms=p99) for name, (p50, p99) in meter.latency_ms().items()
        },
        late_cycles_percent=100.0 * app.loop_monitor.late_share,
        machine=machine,
        recording=None if folder is None else str(folder),
        events=tuple(_event(notice, start_s) for notice in list(app.announcer.recent)[-SHOWN_EVENTS:]),
        problems=tuple(_problems(app, rates, machine, log, now_s)),
    )


def _use(use: InputUse | None) -> dict[str, Any]:
    if use is None:
        return {}
    unused = use.refused_in_a_row >= UNUSED_IN_A_ROW
    return {"used": use.used, "refused": use.refused, "unused": unused, "reason": use.reason}


def _event(notice: Notice, start_s: float) -> Event:
    return Event(time_s=notice.time_s - start_s, severity=notice.severity, text=notice.text)


def _inputs(app: App) -> list[tuple[str, tuple[str, float]]]:
    """Those that are needed: their topic in the log, their name, and how old the newest may be (s)."""
    return [item for item in INPUTS.items() if item[0] == "frame_report" or not app.vision_only]


def _problems(
    app: App, rates: dict[str, Rate], machine: ComputerStatus, log: FlightLog, now_s: float
) -> list[str]:
    found, inputs = app.not_ready(now_s), dict(_inputs(app))
    if app.sensing.camera_problem is None and "frame_report" not in rates:
        found.append("camera: no frame yet")
    for topic, (name, oldest_s) in inputs.items():
        if topic in rates and rates[topic].age_s > oldest_s:
            age_s = rates[topic].age_s
            found.append(f"{name}: silent for {age_s:.{0 if age_s >= 10.0 else 1}f} s")
    for use in app.estimator.tally.uses():
        known = use.name in inputs and use.name != "range"  # an echo is of use over the pad only
        if known and use.refused_in_a_row >= UNUSED_IN_A_ROW and rates[use.name].age_s <= INPUTS[use.name][1]:
            found.append(f"{INPUTS[use.name][0]}: not used: {use.reason}")
    if app.loop_monitor.late_share > LATE_SHARE:
        found.append(f"{100.0 * app.loop_monitor.late_share:.0f} % of the control cycles come late")
    if machine.throttled:
        found.append(f"processor held back: {', '.join(machine.throttled)}")
    if machine.disk_free_mb is not None and machine.disk_free_mb < LEAST_DISK_MB:
        found.append(f"disk: {machine.disk_free_mb:.0f} MB free")
    if (problem := log.problem) is not None:
        found.append(problem)
    return found
