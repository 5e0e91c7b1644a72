"""Our vehicle flown by a recorded client: the same bytes at the same times, in virtual time and calm air.

The frames go through the simulated autopilot's MAVLink endpoint, and what leaves it is read as a record is,
so the whole path is measured: parsing, masks, modes, control, plant, estimator, telemetry.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from companion.messages import Manner
from sitl.autopilot import ESTIMATORS, Autopilot, EstimatorName
from sitl.endpoint import MavlinkEndpoint
from sitl.pad_motion import Meeting, StaticMotion
from sitl.scenario import PadSettings, Scenario
from sitl.simulation import HOME, PHYSICS_STEP_S
from sitl.world import World
from tests.bench.autopilot_record import Record, Stamped, decoder, record_of

STEPS_PER_TALK: Final = 2
AFTER_S: Final = 3.0
AIRFRAMES: Final[dict[Manner, str]] = {"px4": "sih", "ardupilot": "x500"}
ESTIMATOR_OF: Final[dict[Manner, EstimatorName]] = {"px4": "sih", "ardupilot": "exact"}


def fly(manner: Manner, recorded: Record, seed: int) -> Record:
    """Fly our vehicle by what was sent in a recording; it boots as long before as the recorded one did."""
    scenario = Scenario(
        name="setpoints",
        description="calm air, the pad far away",
        autopilot=manner,
        airframe=AIRFRAMES[manner],
        start_heading_deg=0.0,
        pad=PadSettings(motion=StaticMotion(kind="static", meet=Meeting(point_ned_m=(200.0, 200.0)))),
    )
    world = World(scenario, seed)
    errors = ESTIMATORS[ESTIMATOR_OF[manner]]
    autopilot = Autopilot(manner, world.airframe.body, np.random.default_rng((seed, 20)), HOME, errors)
    endpoint = MavlinkEndpoint(autopilot)
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
        world.step(autopilot.step(world.truth(), PHYSICS_STEP_S, world.time_s), PHYSICS_STEP_S)
        steps += 1
        if steps % STEPS_PER_TALK == 0:
            data = endpoint.transmit(world.time_s)
            heard.extend(Stamped(now_s, message, b"") for message in decode(data))
    return record_of(heard, start_s=0.0)
