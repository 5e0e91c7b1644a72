"""The app against an autopilot that is not the bundled one, in real time: our own simulator plays it.

Three parties, as with a real ArduPilot or PX4 SITL: a vehicle (here in the test's own process) that serves
its truth on a UDP port, the external world, and the app, which share that port.
"""

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from sitl.devices.ports import MemoryPort
from sitl.external.link import open_relay
from sitl.run.simulation import Simulation
from sitl.run.tick_timer import LATE_S
from sitl.scenario.scenario import Scenario, load_scenario
from tests.beside import beside
from tests.scenario.flying import COMMAND, FEW_PICTURES, ROOT, environment, scenario_file
from tests.scenario.real_time.quiet_machine import (
    LATE,
    MOST,
    MOST_BESIDE_THREE,
    used_by_others,
    wait_for_quiet,
)

FLIGHT_TIMEOUT_S = 180.0
TRUTHS = (108, 115, 164)  # SIM_STATE, HIL_STATE_QUATERNION, ArduPilot's SIMSTATE
SET_INTERVAL, REQUEST = 511, 512
# a pad that drives slowly: the vehicle's own simulator, whose ground it is, does not carry it along;
# through the waypoint, else a busy machine's delay decides whether the vehicle still meets it
SLOW_LINE: dict[str, Any] = {
    **FEW_PICTURES,
    "pad": {"motion": {"speed_m_s": 0.4, "meet": {"spread_m": 0.0}}},
    "wind": {"mean_m_s": 0.0},
}


@pytest.fixture(autouse=True)
def machine_with_time_to_spare() -> None:
    wait_for_quiet(MOST_BESIDE_THREE)


def vehicles_world() -> Scenario:
    """Where the vehicle flies: ground that is flat, its own simulator's pad being flush with it."""
    static = load_scenario("static")
    pad = static.pad.model_copy(update={"surface_height_m": 0.0})
    return static.model_copy(update={"autopilot": "ardupilot", "pad": pad})


async def fly(scenario: Path, folder: Path) -> tuple[int, str, float]:
    """Exit code and standard error of the app, and how late the vehicle's own simulator was at worst (s)."""
    link, port = await open_relay()
    vehicle = Simulation(
        vehicles_world(), 0, link=link, gps_port=MemoryPort(9600), range_port=MemoryPort(9600),
        deliver_frame=lambda _frame: None, camera_wanted=lambda: False, serve_truth=True,
    )  # fmt: skip
    words = ("--sitl", "--no-ui", "--autopilot", "external", "--connect", f"udp:127.0.0.1:{port}",
             "--scenario", scenario, "--json", folder / "result.json",
             "--record", folder / "log")  # fmt: skip
    async with beside(vehicle.run()):
        process = await asyncio.create_subprocess_exec(
            *COMMAND, *map(str, words), cwd=ROOT, env=environment(),
            stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        try:
            _, said = await asyncio.wait_for(process.communicate(), FLIGHT_TIMEOUT_S)
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
    link.close()
    assert process.returncode is not None
    return process.returncode, said.decode(), vehicle._timer.latest_s


def requests_of_the_app(path: Path) -> set[int]:
    """The messages that the app has asked the autopilot for."""
    log = mavutil.mavlink_connection(str(path))
    asked = set()
    while (message := log.recv_match(type="COMMAND_LONG")) is not None:
        if message.get_srcComponent() in (191, 192) and message.command in (SET_INTERVAL, REQUEST):
            asked.add(round(message.param1))
    return asked


async def test_it_takes_off_finds_the_pad_and_lands(tmp_path: Path) -> None:
    scenario = scenario_file(tmp_path, "line", SLOW_LINE)
    code, said, late_s = await fly(scenario, tmp_path)
    if code and (LATE in said or late_s > LATE_S or used_by_others() > MOST):
        pytest.skip(f"this machine does not keep up with real time: {said.strip()}, {late_s:.1f} s late")
    assert code == 0, said
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["touchdown"]["lateral_error_m"] <= 0.15
    assert result["pad"]["speed_m_s"] == pytest.approx(0.4, abs=0.01)
    asked = requests_of_the_app(tmp_path / "log" / "flight.tlog")
    assert asked
    assert not asked & set(TRUTHS)
