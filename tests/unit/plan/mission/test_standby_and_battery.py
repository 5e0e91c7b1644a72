"""A vehicle that may not fly is left alone; a battery that is low begins nothing new."""

import pytest

from companion.base.messages import Phase
from companion.config import PlanConfig
from companion.plan.planner import Planner
from tests.unit.plan.mission.planner_world import world
from tests.unit.plan.pad_paths import still
from tests.unit.plan.plan_harness import TABLE, VEHICLE, PlanWorld


def in_standby() -> PlanWorld:
    w = world(still())
    w.planner = Planner(PlanConfig(), VEHICLE, 20, 0.1, TABLE, standby="nobody permitted it")
    return w


@pytest.mark.parametrize("armed", [False, True])
def test_in_standby_nothing_is_asked_and_no_setpoint_leaves_whatever_the_time(armed: bool) -> None:
    w = in_standby()
    w.autopilot.armed, w.autopilot.mode = armed, "POSCTL"
    flight = w.fly(200.0)
    assert {phase for _, phase in flight.phases} == {Phase.STANDBY}
    assert w.autopilot.heard == []
    assert all(step.reference is None and not step.actions for step in flight.steps)
    assert flight.told("standby")


def test_standby_ends_when_the_operator_says_so() -> None:
    w = in_standby()
    w.stop = True
    w.fly(1.0)
    assert w.flight.phase is Phase.ABORT
    assert w.autopilot.heard == []


def test_low_in_flight_the_try_under_way_is_the_last() -> None:
    w = world(still())
    w.blind = lambda _t, height: height < 0.9 and w.now_s < 60.0  # the first try fails
    w.fly(60.0, until=lambda w: w.flight.phase is Phase.DESCEND)
    w.autopilot.battery_share = 0.2
    w.fly(60.0, until=lambda w: w.flight.phase in {Phase.HOLD, Phase.LANDED, Phase.ABORT})
    assert w.flight.phase is Phase.HOLD
    assert w.flight.told("battery") == ["battery low: 20 % left, no new try"]


@pytest.mark.parametrize("finishes", [True, False])
def test_critical_in_the_descent_it_is_finished_as_the_settings_say(finishes: bool) -> None:
    config = PlanConfig.model_validate({"mission": {"battery": {"finish_descent": finishes}}})
    w = world(still(), config)
    w.fly(60.0, until=lambda w: w.flight.phase is Phase.DESCEND)
    w.autopilot.battery_share = 0.1
    w.fly(40.0)
    assert w.flight.phase is (Phase.LANDED if finishes else Phase.ABORT)
