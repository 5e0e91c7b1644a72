"""Freezing the estimate stage at any moment and going on in a new one: to the bit, or a clear refusal."""

from __future__ import annotations

import copy
import json
import math
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from companion.base.geometry import quat_from_euler, quat_multiply
from companion.base.messages import AutopilotAttitude, GpsFix, PadSighting
from companion.config import EstimateConfig, OrientationConfig
from companion.estimate.estimator import Estimator
from companion.estimate.gating import Gate
from companion.estimate.vehicle.freezing import fill, held, plain, thawed
from tests.unit.estimate.estimate_flight import (
    ANTENNA,
    FIELD_NED_UT,
    VEHICLE,
    Flight,
    Sample,
    circle,
    feed,
    new_estimator,
    pad_figure_8,
)

FLIGHT = Flight(circle(3.0, 1.0, 3.0), pad_figure_8, seed=11, duration_s=13.0)
# standing; aligning; aligned, no fix; climbing; the pad about to be seen; just seen; seen for long
MOMENTS_S = (0.03, 1.237, 3.05, 7.5, 9.999, 10.1, 12.26)
ASK_EVERY = 7  # samples


def settings(**changes: Any) -> EstimateConfig:
    return EstimateConfig(magnetic_field_ned_ut=FIELD_NED_UT, **changes)


def resumed(state: dict[str, Any], config: EstimateConfig | None = None, width_m: float = 1.3) -> Estimator:
    return Estimator.resume(state, config or settings(), VEHICLE, ANTENNA, 0.5 * width_m)


def through_json(state: dict[str, Any]) -> dict[str, Any]:
    thawed_state: dict[str, Any] = json.loads(json.dumps(state, allow_nan=False))
    return thawed_state


def give(estimator: Estimator, arrival_s: float, sample: Sample) -> None:
    """A sample, and after every fix the autopilot's attitude, which is 3 deg/s away: a step of the bias."""
    feed(estimator, sample)
    if isinstance(sample, GpsFix):
        turn = quat_from_euler(0.0, 0.0, math.radians(3.0) * max(arrival_s - 11.0, 0.0))
        attitude = quat_multiply(FLIGHT.attitude(arrival_s), turn)
        estimator.add_autopilot_attitude(AutopilotAttitude(arrival_s - 0.01, attitude))


def bits(value: object) -> object:
    """A message's numbers as texts that tell every bit, the signs of zeros too."""
    if value is None:
        return None
    return [repr(getattr(value, f.name)) for f in fields(value)]  # type: ignore[arg-type]


def said(estimator: Estimator, now_s: float) -> list[object]:
    covariances = (estimator.vehicle_covariance(), estimator.pad_covariance(now_s))
    return [
        bits(estimator.vehicle(now_s)),
        bits(estimator.pad(now_s)),
        bits(estimator.pad_prior(now_s - 0.02)),
        [None if P is None else P.tobytes() for P in covariances],
        estimator.refused,
    ]


def go_on(estimator: Estimator, start_s: float, end_s: float = math.inf) -> list[list[object]]:
    """Give it what arrives in a span of time; what it says from time to time."""
    answers = []
    for k, (arrival_s, sample) in enumerate(FLIGHT.samples):
        if start_s < arrival_s <= end_s:
            give(estimator, arrival_s, sample)
            if k % ASK_EVERY == 0:
                answers.append(said(estimator, arrival_s))
    return answers


@dataclass(frozen=True)
class Run:
    states: dict[float, dict[str, Any]]
    answers: dict[float, list[list[object]]]  # from each moment to the next


@lru_cache
def continuous(kind: str = "complementary") -> Run:
    """One flight without a break, its states frozen in passing."""
    estimator = new_estimator(settings(orientation=OrientationConfig(kind=kind)))  # type: ignore[arg-type]
    states, answers = {}, {}
    go_on(estimator, -math.inf, MOMENTS_S[0])
    for start_s, end_s in zip(MOMENTS_S, (*MOMENTS_S[1:], math.inf), strict=True):
        states[start_s] = estimator.freeze()
        answers[start_s] = go_on(estimator, start_s, end_s)
    return Run(states, answers)


@pytest.mark.parametrize("moment_s", MOMENTS_S)
def test_resumed_run_equals_a_continuous_one_to_the_bit(moment_s: float) -> None:
    run = continuous()
    later = [answer for start_s in MOMENTS_S if start_s >= moment_s for answer in run.answers[start_s]]
    assert go_on(resumed(through_json(run.states[moment_s])), moment_s) == later


def test_the_flight_has_all_that_makes_it_hard() -> None:
    """Late fixes and sightings from before each freeze are still to come; the pad is seen; a bias steps."""
    run = continuous()
    for moment_s in MOMENTS_S[-2:]:
        late = [s for t, s in FLIGHT.samples if t > moment_s and s.time_s < moment_s]
        assert any(isinstance(sample, PadSighting) for sample in late)
    assert any(isinstance(s, GpsFix) for t, s in FLIGHT.samples if t > MOMENTS_S[-1] > s.time_s)
    standing, flying = run.answers[MOMENTS_S[0]][0], run.answers[MOMENTS_S[-1]][-1]
    assert standing[:2] == [None, None]
    assert None not in flying[:3]
    with_step = go_on(resumed(run.states[MOMENTS_S[-2]]), MOMENTS_S[-2])[-1]
    without = resumed(run.states[MOMENTS_S[-2]])
    for t, sample in FLIGHT.samples:
        if t > MOMENTS_S[-2]:
            feed(without, sample)
    assert with_step[0] != said(without, FLIGHT.samples[-1][0])[0]


def test_madgwick_filter_is_resumed_too() -> None:
    run, moment_s = continuous("madgwick"), MOMENTS_S[-2]
    config = settings(orientation=OrientationConfig(kind="madgwick"))
    estimator = resumed(through_json(run.states[moment_s]), config)
    assert go_on(estimator, moment_s, MOMENTS_S[-1]) == run.answers[moment_s]


def test_resumed_stage_freezes_to_the_same_state() -> None:
    for state in continuous().states.values():
        assert resumed(through_json(state)).freeze() == state


def test_frozen_state_does_not_change_as_the_flight_goes_on() -> None:
    state = continuous().states[MOMENTS_S[-2]]
    before = copy.deepcopy(state)
    go_on(resumed(state), MOMENTS_S[-2])
    assert state == before


def test_state_from_other_settings_is_refused_by_name() -> None:
    state = through_json(continuous().states[MOMENTS_S[-2]])
    other = settings(pad=settings().pad.model_copy(update={"forget_s": 7.0}))
    with pytest.raises(ValueError, match=r"estimate\.pad\.forget_s 10\.0, expected 7\.0"):
        resumed(state, other)
    with pytest.raises(ValueError, match=r"board_half_width_m 0\.65, expected 0\.5"):
        resumed(state, width_m=1.0)


def drop_a_key(state: dict[str, Any]) -> None:
    del state["parts"]


def drop_a_part(state: dict[str, Any]) -> None:
    state["parts"].pop()


def shorten_a_list(state: dict[str, Any]) -> None:
    _, values = state["parts"][1]
    values["_times_s"]["list"].pop()


def touch_a_bit(state: dict[str, Any]) -> None:
    _, values = state["parts"][1]
    values["_times_s"]["list"][0] = math.nextafter(values["_times_s"]["list"][0], 0.0)


@pytest.mark.parametrize("damage", [drop_a_key, drop_a_part, shorten_a_list, touch_a_bit])
def test_damaged_state_is_refused(damage: Any) -> None:
    state = through_json(continuous().states[MOMENTS_S[-2]])
    damage(state)
    with pytest.raises(ValueError, match="damaged or truncated"):
        resumed(state)


@pytest.mark.parametrize("state", [{}, [], None, {"format": 0}])
def test_what_is_no_state_is_refused(state: Any) -> None:
    with pytest.raises(ValueError, match="expected one of format 1"):
        resumed(state)


def test_parts_of_another_version_are_refused() -> None:
    estimator = new_estimator()
    for change in ("more", "fewer"):
        state = held(new_estimator())
        if change == "more":
            state[1][1]["_gone_since"] = 0.0
        else:
            del state[1][1]["_times_s"]
        with pytest.raises(ValueError, match="another version"):
            fill(estimator, state)


@pytest.mark.parametrize(
    "data",
    [
        {"estimate.gating.Gate": [1, 2]},
        {"estimate.gating.Unheard": [1]},
        {"estimate.gating.Timeline": [None, 1.0]},
        {"os.system": ["true"]},
        {"messages.np.array": [1]},
    ],
)
def test_records_of_another_version_are_refused(data: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="another version"):
        thawed(data)


def test_values_come_back_as_they_were() -> None:
    value = {
        "numbers": (0.1, -0.0, 1e-310, math.inf, -math.inf, 3, True, None),
        "texts": ["a", ("b",), []],
        "gate": Gate(1, 2, 3, -math.inf),
        "scalar": np.float64(0.1),
    }
    back = thawed(json.loads(json.dumps(plain(value), allow_nan=False)))
    assert repr(back) == repr(value)
    assert math.isnan(thawed(plain(math.nan)))
    rows = np.random.default_rng(0).normal(size=(3, 4))
    for array in (rows, rows.T, rows[:, 0]):
        again = thawed(plain(array))
        assert np.array_equal(again, array)
        assert again.flags.fnc == array.flags.fnc


def test_what_is_unknown_is_not_frozen_in_silence() -> None:
    with pytest.raises(TypeError, match="cannot freeze a set"):
        plain({1, 2})
