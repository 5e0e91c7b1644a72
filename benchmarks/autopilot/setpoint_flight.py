"""Our vehicle flown by a recorded client: the same bytes at the same times, in virtual time and calm air.

The frames go through the simulated autopilot's MAVLink endpoint, and what leaves it is read as a record is,
so the whole path is measured: parsing, masks, modes, control, plant, estimator, telemetry.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from benchmarks.autopilot.autopilot_record import AutopilotRecord, Stamped, decoder, record_of
from companion.base.autopilot_kind import AutopilotKind
from sitl.autopilot import ESTIMATORS, EstimatorName, SimulatedAutopilot
from sitl.mavlink.endpoint import MavlinkEndpoint
from sitl.pad.paths import Meeting, StaticMotion
from sitl.run.simulation import PHYSICS_STEP_S
from sitl.scenario.home import magnetic_field_ned_ut
from sitl.scenario.scenario import PadSettings, Scenario
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.world.world import World

STEPS_PER_TALK: Final = 2
AFTER_S: Final = 3.0
FAR_M: Final = 99.0  # no rangefinder's echo
AIRFRAMES: Final[dict[AutopilotKind, str]] = {"px4": "sih", "ardupilot": "arducopter_sitl"}
ESTIMATOR_OF: Final[dict[AutopilotKind, EstimatorName]] = {"px4": "sih", "ardupilot": "arducopter_sitl"}


def fly(autopilot_kind: AutopilotKind, recorded: AutopilotRecord, seed: int) -> AutopilotRecord:
    """Fly our vehicle by what was sent in a recording; it boots as long before as the recorded one did."""
    scenario = Scenario(
        name="setpoints",
        description="calm air, the pad far away",
        autopilot=autopilot_kind,
        airframe=AIRFRAMES[autopilot_kind],
        start_heading_deg=0.0,
        pad=PadSettings(motion=StaticMotion(kind="static", meet=Meeting(point_ned_m=(200.0, 200.0)))),
    )
    world = World(scenario, seed)
    errors = ESTIMATORS[ESTIMATOR_OF[autopilot_kind]]
    airframe = world.airframe
    rng = np.random.default_rng((seed, 20))
    autopilot = SimulatedAutopilot(autopilot_kind, airframe.body, rng, scenario.place, errors, airframe.rates)
    sensors = SimulatedAutopilotSensors(
        np.random.default_rng((seed, 21)),
        PHYSICS_STEP_S,
        home=scenario.place,
        field_ned_ut=magnetic_field_ned_ut(scenario.place),
        imu_filter=autopilot.profile.imu_filter,
    )
    endpoint = MavlinkEndpoint(autopilot, sensors)
    lead_s = -recorded.booted_s
    waiting = iter(recorded.sent)
    due = next(waiting, None)
    heard: list[Stamped] = []
    decode = decoder()
    end_s = recorded.sent[-1].time_s + AFTER_S
    steps = 0
    while (now_s := world.time_s - lead_s) < end_s:
        while due is not None and due.time_s <= now_s:
            endpoint.receive(due.frame, world.time_s)
            heard.append(due)
            due = next(waiting, None)
        motors = autopilot.step(world.truth(), PHYSICS_STEP_S, world.time_s)
        world.step(motors, PHYSICS_STEP_S)
        sensors.step(world.time_s, world.state, 0.25 * sum(motors), lambda: FAR_M)
        steps += 1
        if steps % STEPS_PER_TALK == 0:
            data = endpoint.transmit(world.time_s)
            heard.extend(Stamped(now_s, message, b"") for message in decode(data))
    return record_of(heard, start_s=0.0)
