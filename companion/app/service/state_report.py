"""What the running service says of itself: `companion status` shows it, as text or as JSON."""

import math
from typing import Any, Final

from pydantic import BaseModel, ConfigDict

from companion.app.app import App
from companion.app.service.computer_status import ComputerStatus
from companion.base.messages import InputUse, Notice
from companion.base.second_sources import SourceState, judged
from companion.flightlog.meter import Meter, Rate

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
        """In one line, for a ground station."""
        if self.order is not None:
            head = f"{self.phase.replace('_', ' ')}, {self.order}"
        elif self.vision_only:
            head = "does not send the pad" if self.problems else "sends the pad when it is seen"
        else:
            head = "not ready to land" if self.problems else "ready to land"
        return ": ".join((head, "; ".join(self.problems))) if self.problems else head


def state_report(
    app: App, meter: Meter, machine: ComputerStatus, recording: str | None, now_s: float, start_s: float
) -> StateReport:
    """The app's state now; times are the loop's (s)."""
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
            for row, state, words in judged(app.sources.comparisons)
        ),
        latency={
            name: LatencyReport(p50_ms=p50, p99_ms=p99) for name, (p50, p99) in meter.latency_ms().items()
        },
        late_cycles_percent=100.0 * app.loop_monitor.late_share,
        machine=machine,
        recording=recording,
        events=tuple(_event(notice, start_s) for notice in list(app.announcer.recent)[-SHOWN_EVENTS:]),
        problems=tuple(_problems(app, rates, machine, now_s)),
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


def _problems(app: App, rates: dict[str, Rate], machine: ComputerStatus, now_s: float) -> list[str]:
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
    return found
