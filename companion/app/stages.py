"""The stages of one flight, made from the settings."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from companion.app.hardware import Hardware
from companion.app.sensing import Notify, Sensing
from companion.app.service.stamp_file import StampKeeper
from companion.app.source_watch import SourceWatch
from companion.app.target_output import TargetOutput
from companion.app.timing.control_timer import ControlTimer
from companion.app.timing.estimate_watch import EstimateWatch
from companion.base.clock import Clock, unix_time_s
from companion.base.files import find_file
from companion.config import (
    CameraConfig,
    CompanionConfig,
    VehicleConfig,
    load_model,
    load_mount,
    load_vehicle,
)
from companion.estimate.estimator import StateEstimator
from companion.flightlog.record import FlightLog
from companion.link.session import Session
from companion.link.signing import LinkSigning
from companion.pad import Pad, load_pad
from companion.plan.landing.standing_height import StandingHeight
from companion.plan.planner import Planner
from companion.plan.speed.laws import load_speed_controller
from companion.sense.vision.pipeline import Vision


@dataclass(frozen=True, slots=True)
class Stages:
    """What the tasks of the app work with. The controller follows when the autopilot is known."""

    vehicle: VehicleConfig
    session: Session
    estimator: StateEstimator
    sensing: Sensing
    sources: SourceWatch
    control_timer: ControlTimer
    stamps: StampKeeper
    estimate_watch: EstimateWatch
    target: TargetOutput | None  # with `control.output: landing_target`
    make_planner: Callable[[str | None], Planner]  # of a mission; given why it stands by, if it does


def build_stages(
    config: CompanionConfig,
    hardware: Hardware,
    log: FlightLog,
    clock: Clock,
    notify: Notify,
) -> Stages:
    """Make the stages and write the settings that they use into the log.

    Raises:
        ConfigError: a settings file named in the configuration is missing or wrong.
    """
    mount = load_mount(config.mount, config.camera)
    vehicle = load_vehicle(config.vehicle, config.mount, config.camera)
    camera = load_model(CameraConfig, find_file("cameras", config.camera))
    pad = load_pad(config.pad)
    antenna = config.sense.gps.antenna_position_body_m
    session = _session(config, hardware.signing)
    estimator = StateEstimator(config.estimate, vehicle, antenna, 0.5 * min(pad.width_m, pad.length_m))
    sensing = Sensing(
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
    control_timer = ControlTimer(clock, 1.0 / config.control.rate_hz)
    sensing.frame_fused = control_timer.frame_fused
    log.write_settings(
        config=config,
        vehicle=vehicle,
        camera=camera,
        pad=pad,
        **sensing.calibrations,
        **({} if mount is None else {"mount": mount}),
    )
    standing_height = StandingHeight(vehicle, config.sense.range.minimum_m)
    make_planner = _planner_maker(config, vehicle, pad, standing_height)
    sources = SourceWatch(estimator, session, standing_height, config.estimate, vehicle, notify)
    stamps = StampKeeper(
        hardware.stamp_file, hardware.signing, lambda text: notify("signing", text, "warning")
    )
    watch = EstimateWatch(estimator, session, log, clock, notify)
    tells = config.control.output == "landing_target"
    target = TargetOutput(config.control, pad, estimator, session) if tells else None
    return Stages(
        vehicle, session, estimator, sensing, sources, control_timer, stamps, watch, target, make_planner
    )


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
