"""Attitude and thrust to a simulated ArduPilot that hovers at 0.35: thrust has to be thrust."""

import asyncio
from dataclasses import dataclass

import numpy as np
import pytest

from companion.base.clock import Clock
from companion.base.geometry import GRAVITY_M_S2, quat_from_euler
from companion.base.messages import Action, ActionKind, ActionResult, Setpoint
from companion.config import LinkConfig
from companion.link.actions.actions import PymavlinkActions
from companion.link.session import Session
from sitl.autopilot.control.estimator import NO_ERRORS
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.mavlink.endpoint import MavlinkEndpoint
from tests.unit.sitl.autopilot.autopilot_flight import HOME, AutopilotFlight, SimpleVehicle, frame_450
from tests.virtual_time import in_virtual_time

HOVER_THRUST = 0.35
STEP_S = 0.01


@dataclass
class ControlTaken:
    """How taking control went, and the speed downwards (m/s) after two seconds of hover thrust."""

    result: ActionResult
    options: float
    sink_m_s: float


def hovering() -> AutopilotFlight:
    flight = AutopilotFlight("ardupilot")
    mass_kg = flight.vehicle.airframe.mass_kg
    strong = frame_450(max_thrust_n=mass_kg * GRAVITY_M_S2 / (4.0 * HOVER_THRUST))
    flight.vehicle = SimpleVehicle(strong)
    flight.autopilot = SimulatedAutopilot("ardupilot", strong, np.random.default_rng(1), HOME, NO_ERRORS)
    flight.take_off(4.0)
    return flight


@in_virtual_time
async def fly_by_attitude(config: LinkConfig, options: int) -> ControlTaken:
    """Take control of a hovering ArduPilot and send level attitudes with the vehicle's hover thrust."""
    flight, clock = hovering(), Clock()
    flight.autopilot.parameters.set("GUID_OPTIONS", options)
    endpoint, session = MavlinkEndpoint(flight.autopilot), Session(config)

    def send(data: bytes) -> None:
        endpoint.receive(data, flight.now_s)

    async def world() -> None:
        while True:
            session.receive(endpoint.transmit(flight.now_s), clock.now_s())
            send(session.tick(clock.now_s()))
            flight.run(STEP_S)
            await asyncio.sleep(STEP_S)

    stepping = asyncio.ensure_future(world())
    await asyncio.sleep(1.1)
    actions = PymavlinkActions(session, send, clock, config, attitude_setpoints=True)
    result = await actions.perform(Action(ActionKind.TAKE_CONTROL))
    for _ in range(60):
        level = quat_from_euler(0.0, 0.0, 0.0)
        setpoint = Setpoint(clock.now_s(), attitude=level, thrust=HOVER_THRUST)
        send(session.send_setpoint(setpoint, clock.now_s()))
        await asyncio.sleep(1.0 / 30.0)
    stepping.cancel()
    await asyncio.gather(stepping, return_exceptions=True)
    return ControlTaken(result, flight.autopilot.parameters["GUID_OPTIONS"], flight.vehicle.velocity[2])


@pytest.mark.parametrize(("options", "allowed"), [(8, False), (0, True)])
def test_hover_thrust_hovers_once_thrust_is_thrust(options: int, allowed: bool) -> None:
    ending = fly_by_attitude(LinkConfig(set_parameters=allowed), options)
    assert ending.result.accepted
    assert ending.options == 8
    assert ending.sink_m_s == pytest.approx(0.0, abs=0.15)


def test_where_hover_thrust_would_be_a_descent_control_is_refused() -> None:
    ending = fly_by_attitude(LinkConfig(), 0)
    assert not ending.result.accepted
    assert ending.result.text.startswith("GUID_OPTIONS is 0: thrust is read as climb rate; expected 8")
    assert ending.options == 0
    assert ending.sink_m_s > 0.3  # which is why
