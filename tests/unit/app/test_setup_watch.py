"""What of the autopilot's parameters stands against flying it, before anything moves."""

import pytest

from companion.app.stages import SETUP_AGAIN_S, SetupWatch
from companion.config import CompanionConfig
from companion.link.autopilot_setup import UNREAD
from companion.link.session import Session
from tests.unit.link.fake_autopilot import FakeAutopilot

STEP_S = 0.02


class WatchedSetup:
    """A session with an ArduPilot, watched as in the app's cycles."""

    def __init__(self, config: CompanionConfig, *, reads_setup: bool = True) -> None:
        self.autopilot = FakeAutopilot(autopilot_kind="ardupilot", mode="GUIDED", armed=True)
        self.autopilot.parameters |= {"GUID_TIMEOUT": 3.0, "GUID_OPTIONS": 8.0}
        self.session = Session(config.link, reads_setup=reads_setup)
        self.watch, self.now_s = SetupWatch(self.session, config), 0.0

    def run(self, seconds: float) -> list[str]:
        """What stands against it in each cycle, without repeats."""
        said = list[str]()
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self.session.receive(self.autopilot.tick(self.now_s), self.now_s)
            sent = self.session.tick(self.now_s)
            self.session.receive(self.autopilot.receive(sent, self.now_s), self.now_s)
            words = self.watch.problem(self.now_s)
            said += [] if said[-1:] == [words] else [words]
            self.now_s += STEP_S
        return said


def test_until_they_are_read_and_while_they_refuse_control_that_is_said() -> None:
    watched = WatchedSetup(CompanionConfig())
    watched.autopilot.deaf_to_parameters = 5  # asked again
    said = watched.run(2.0)
    assert said[-2] == UNREAD
    assert said[-1].startswith("GUID_TIMEOUT is 3: it keeps the last tilt this long")


def test_what_an_operator_corrects_is_known_without_a_new_start() -> None:
    watched = WatchedSetup(CompanionConfig())
    watched.run(2.0)
    watched.autopilot.parameters["GUID_TIMEOUT"] = 1.0
    assert watched.run(SETUP_AGAIN_S + 1.0)[-1] == ""
    # AND parameters that are good are not asked for again
    watched.autopilot.heard.clear()
    watched.run(3.0 * SETUP_AGAIN_S)
    assert not [m for m in watched.autopilot.heard if m.get_type() == "PARAM_REQUEST_READ"]


@pytest.mark.parametrize(
    ("setpoint", "may_set", "why"),
    [
        ("auto", False, "GUID_OPTIONS is 0: thrust is read as climb rate; expected 8, "),
        ("auto", True, ""),
        ("velocity", False, ""),
    ],
)
def test_a_thrust_that_is_a_climb_rate_stands_against_attitudes_alone(
    setpoint: str, may_set: bool, why: str
) -> None:
    settings = {"control": {"setpoint": setpoint}, "link": {"set_parameters": may_set}}
    watched = WatchedSetup(CompanionConfig.model_validate(settings))
    watched.autopilot.parameters |= {"GUID_TIMEOUT": 1.0, "GUID_OPTIONS": 0.0}
    said = watched.run(2.0)[-1]
    assert said.startswith(why)
    assert bool(said) is bool(why)


def test_without_a_flight_of_ours_no_parameter_is_read_or_stands_against_it() -> None:
    assert set(WatchedSetup(CompanionConfig(), reads_setup=False).run(2.0)) == {""}
