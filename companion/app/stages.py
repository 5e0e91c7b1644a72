"""The stages of one flight, made from the settings, and what watches them."""

import asyncio
import math
from collections.abc import Callable, Iterator
from typing import Final

from companion.app.hardware import Hardware, StampKeeper
from companion.app.pacing import ControlTimer
from companion.app.sensing import Notify, Sensing
from companion.base.autopilots import PROFILES
from companion.base.clock import Clock, unix_time_s
from companion.base.files import find_file
from companion.base.geometry import Quaternion, Vector3, quat_rotate_inverse
from companion.base.magnetic_field import compare_declination
from companion.base.messages import (
    EstimatorInputs,
    LandedState,
    LandingTargetPose,
    PadSighting,
    PadState,
    Quantity,
    SourceComparison,
    VehicleState,
)
from companion.base.second_sources import announced, current
from companion.config import (
    CameraConfig,
    CompanionConfig,
    ControlConfig,
    EstimateConfig,
    VehicleConfig,
    load_model,
    load_mount,
    load_vehicle,
)
from companion.control.landing_target import SeenPad, TargetLead, landing_target
from companion.control.setpoints import resolved
from companion.estimate.estimator import StateEstimator
from companion.flightlog.record import FlightLog
from companion.link.autopilot_setup import setup_refusal
from companion.link.session import Session
from companion.link.signing import LinkSigning
from companion.pad import Pad, load_pad
from companion.plan.landing.standing_height import StandingHeight
from companion.plan.planner import Planner
from companion.plan.speed.laws import load_speed_controller
from companion.sense.vision.pipeline import Vision

# ---------------------------------------------------------------- watches


class SourceWatch:
    """Ask it in every cycle; each quantity whose sources differ is announced once a mission."""

    def __init__(
        self,
        estimator: StateEstimator,
        session: Session,
        standing_height: StandingHeight,
        config: EstimateConfig,
        vehicle: VehicleConfig,
        notify: Notify,
    ) -> None:
        self._estimator, self._session, self._standing_height = estimator, session, standing_height
        self._config, self._vehicle, self._notify = config, vehicle, notify
        self._declination: tuple[Vector3, SourceComparison] | None = None  # and where
        self._announced: set[Quantity] = set()

    def begin(self) -> None:
        self._announced.clear()
        self._estimator.begin_checks()

    def comparisons(self, now_s: float) -> tuple[SourceComparison, ...]:
        """The newest of each that is not old."""
        found = (
            *self._estimator.comparisons,
            *self._of_the_place(),
            *self._of_the_link(),
            *self._standing_height.comparisons,
        )
        return current(found, now_s)

    def look(self, now_s: float) -> tuple[SourceComparison, ...]:
        """The newest of each; announces what was not announced before."""
        found = self.comparisons(now_s)
        for quantity, words in announced(found):
            if quantity not in self._announced:
                self._announced.add(quantity)
                self._notify("sources", words, "warning")
        return found

    def _of_the_place(self) -> Iterator[SourceComparison]:
        """The geomagnetic field that was told, where the first fix is; looked up once."""
        place, told = self._estimator.origin, self._config.magnetic_field_ned_ut
        if place is None or told is None:
            return
        if self._declination is None or self._declination[0] != place:
            std_ut = self._config.ekf.field_std_ut
            self._declination = place, compare_declination(told, std_ut, place, unix_time_s())
        yield self._declination[1]

    def _of_the_link(self) -> Iterator[SourceComparison]:
        setup, line = self._session.setup, self._session.timesync.line
        if setup is not None and setup.hover_thrust is not None:
            told, own = self._vehicle.hover_thrust, setup.hover_thrust
            apart = 100.0 * abs(own / told - 1.0)
            yield SourceComparison(0.0, Quantity.HOVER_THRUST, f"{told:.2f}", f"{own:.2f}", apart, 0.0)
        if line is not None and self._session.timesync.settled:
            apart = 100.0 * abs(line.rate)
            yield SourceComparison(line.at_s, Quantity.CLOCK_RATE, "1", f"{1.0 + line.rate:.4f}", apart, 0.0)


SETUP_AGAIN_S: Final = 5.0  # longer than until each of its parameters has been answered or given up


class SetupWatch:
    """Ask it in every cycle: what of the autopilot's parameters stands against flying it."""

    def __init__(self, session: Session, config: CompanionConfig) -> None:
        self._session, self._config = session, config
        self._again_s = -math.inf

    def problem(self, now_s: float) -> str:
        """In words; "" where nothing does. Then they are read again and again: somebody may correct them."""
        session, kind = self._session, self._session.state.autopilot_kind
        if not session.reads_setup or kind is None:
            return ""
        by_attitude = resolved(self._config.control, kind).setpoint == "attitude"
        may_set = self._config.link.set_parameters
        why = setup_refusal(session.setup, kind, by_attitude=by_attitude, may_set=may_set)
        if why and session.setup is not None and session.state.connected and now_s >= self._again_s:
            self._again_s = now_s + SETUP_AGAIN_S
            session.renew_setup()
        return why


# ---------------------------------------------------------------- the estimator's inputs

ESTIMATE_WATCH_S: Final = 1.0


class EstimateWatch:
    """`run` is a task of the app's."""

    def __init__(
        self, estimator: StateEstimator, session: Session, log: FlightLog, clock: Clock, notify: Notify
    ) -> None:
        self._estimator, self._session, self._log = estimator, session, log
        self._clock, self._notify = clock, notify

    async def run(self) -> None:
        while True:
            await asyncio.sleep(ESTIMATE_WATCH_S)
            self.look(self._clock.now_s())

    def look(self, now_s: float) -> None:
        """Log the counts; an estimate that refuses all of an input starts again where nothing flies by it."""
        self._log.write("estimator_inputs", EstimatorInputs(now_s, self._estimator.tally.uses()), now_s)
        autopilot = self._session.state
        if autopilot.armed or autopilot.landed is not LandedState.ON_GROUND:
            return
        if (words := self._estimator.recover(now_s)) is not None:
            self._notify("estimate", words, "warning")


# ---------------------------------------------------------------- vision only
# The pad as a landing target for the autopilot's own landing, and nothing else: one target for each exposure
# that shows the pad, as soon as all that it needs has come. A pad that is not seen is silence. Where there is
# an estimate of the vehicle, an exposure counts once the pad filter has taken it; else it is sent as the
# frame shows it. Nothing here flies.

STANDBY_WORDS: Final = "vision only: the pad is sent to the autopilot, which lands by itself"
OLDEST_TARGET_S: Final = 1.0  # an exposure that could not be sent by then says nothing of now


class TargetOutput:
    """Ask `due` in every cycle."""

    def __init__(self, config: ControlConfig, pad: Pad, estimator: StateEstimator, session: Session) -> None:
        self._size_m = (pad.width_m, pad.length_m)
        self._lead = TargetLead(config.target_lead_s) if config.target_lead_s > 0.0 else None
        self._estimator, self._session = estimator, session
        self._sent_exposure_s = float("-inf")

    def due(
        self, vehicle: VehicleState | None, pad: PadState | None, sighting: PadSighting | None, now_s: float
    ) -> LandingTargetPose | None:
        """The target of the newest exposure that shows the pad, unless it has been sent or is old.

        `vehicle` and `pad` are the estimates at now_s, `sighting` is the newest one.
        """
        kind, seen, estimate = self._session.state.autopilot_kind, None, None
        if vehicle is None or not vehicle.aligned:
            seen = None if sighting is None else SeenPad.by_sighting(sighting)
        elif pad is not None:
            at_exposure = self._estimator.pad(pad.seen_time_s)
            attitude = self._estimator.attitude(pad.seen_time_s)
            if at_exposure is not None and attitude is not None:
                seen, estimate = SeenPad.by_estimate(at_exposure, attitude), (at_exposure, attitude)
        if kind is None or not self._session.state.connected or seen is None:
            return None
        if not self._sent_exposure_s < seen.time_s <= now_s <= seen.time_s + OLDEST_TARGET_S:
            return None
        make, own_pose = PROFILES[kind], None
        if make.target_frame == "local_ned":
            own_pose = self._own_pose(seen.time_s)
            if own_pose is None:
                return None  # it may come until the next cycle
        self._sent_exposure_s = seen.time_s
        if estimate is not None and self._lead is not None:
            at_exposure, attitude = estimate
            moved_ned_m = self._lead.ned_m(at_exposure, now_s, make)
            seen = seen.moved(quat_rotate_inverse(attitude, moved_ned_m))
        return landing_target(seen, self._size_m, own_pose)

    def _own_pose(self, time_s: float) -> tuple[Vector3, Quaternion] | None:
        pose = None if self._session.poses is None else self._session.poses.at(time_s)
        return None if pose is None else (pose.position_ned_m, pose.attitude)

    def problems(self, now_s: float) -> list[str]:
        """What keeps the pad from being sent, if it is seen."""
        state = self._session.state
        if not state.connected:
            return ["autopilot: no heartbeat"]
        if state.autopilot_kind is None:
            return ["autopilot: expected PX4 or ArduPilot"]
        local = PROFILES[state.autopilot_kind].target_frame == "local_ned"
        if local and (self._session.poses is None or not self._session.poses.fresh(now_s)):
            return ["autopilot: its position and attitude do not come (LOCAL_POSITION_NED, ATTITUDE)"]
        return []


class Stages:
    """What the tasks of the app work with. The controller follows when the autopilot is known."""

    def __init__(
        self, config: CompanionConfig, hardware: Hardware, log: FlightLog, clock: Clock, notify: Notify
    ) -> None:
        """Make the stages and write the settings that they use into the log."""
        mount = load_mount(config.mount, config.camera)
        vehicle = self.vehicle = load_vehicle(config.vehicle, config.mount, config.camera)
        camera = load_model(CameraConfig, find_file("cameras", config.camera))
        pad = load_pad(config.pad)
        antenna, half_width_m = config.sense.gps.antenna_position_body_m, 0.5 * min(pad.width_m, pad.length_m)
        session = self.session = _session(config, hardware.signing)
        estimator = self.estimator = StateEstimator(config.estimate, vehicle, antenna, half_width_m)
        self.sensing = Sensing(
            config,
            hardware,
            Vision(pad, camera, vehicle, config.sense.vision),
            estimator,
            session.onboard,
            clock=clock,
            log=log,
            notify=notify,
            frame_time_offset_s=vehicle.camera_time_offset_s,
        )
        self.control_timer = ControlTimer(clock, 1.0 / config.control.rate_hz)
        self.sensing.frame_fused = self.control_timer.frame_fused
        log.write_settings(
            config=config,
            vehicle=vehicle,
            camera=camera,
            pad=pad,
            **self.sensing.calibrations,
            **({} if mount is None else {"mount": mount}),
        )
        standing_height = StandingHeight(vehicle)
        # of a mission; given why it stands by, if it does
        self.make_planner = _planner_maker(config, vehicle, pad, standing_height)
        self.sources = SourceWatch(estimator, session, standing_height, config.estimate, vehicle, notify)
        self.setup_watch = SetupWatch(session, config)
        self.stamps = StampKeeper(
            hardware.stamp_file, hardware.signing, lambda text: notify("signing", text, "warning")
        )
        self.estimate_watch = EstimateWatch(estimator, session, log, clock, notify)
        self.target: TargetOutput | None = None
        if config.control.output == "landing_target":
            self.target = TargetOutput(config.control, pad, estimator, session)


def _planner_maker(
    config: CompanionConfig, vehicle: VehicleConfig, pad: Pad, standing_height: StandingHeight
) -> Callable[[str | None], Planner]:
    """What makes a mission's planner; what is learnt of the standing vehicle outlives missions."""
    law, pace = load_speed_controller(config.plan)
    control = config.control

    def make(standby: str | None) -> Planner:
        return Planner(
            config.plan,
            vehicle,
            control.horizon_steps,
            control.step_s,
            law,
            pace=pace,
            standby=standby,
            pad_half_width_m=0.5 * min(pad.width_m, pad.length_m),
            pad_reach_m=0.5 * math.hypot(pad.width_m, pad.length_m),
            standing_height=standing_height,
        )

    return make


def _session(config: CompanionConfig, signing: LinkSigning | None) -> Session:
    flies = config.control.output == "setpoints"
    return Session(
        config.link,
        config.sense if config.sense.source == "autopilot" else None,
        reads_setup=flies,
        follows_pose=not flies,
        signing=signing,
        orders=config.orders,
        process=int(1e3 * unix_time_s()) % 2**32,
    )
