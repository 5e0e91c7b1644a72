"""The check over the pad of a right vehicle, and on its samples as if they came from wrong settings."""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import pytest

from companion.base.geometry import (
    Quaternion,
    Vector3,
    add,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
    scale,
)
from companion.base.messages import ImuSample, MagSample, PadSighting, RangeSample
from companion.tools.pad_check.job import cause_lines, report_json, verdict_line
from companion.tools.pad_check.moves import RecentSamples
from companion.tools.pad_check.wizard import STEP_TIMEOUT_S, STEPS, Report, Say, Wizard
from tests.unit.tools.pad_check.hand_check import MOUNTING, Checked, check

QUESTIONS = (
    "level is level",
    "camera and horizon agree",
    "compass",
    "height, low",
    "up is up",
    "height, high",
    "right is right",
    "forward is forward",
    "turn right",
    "compass turns along",
    "roll right",
    "accelerometer tilts along, roll right",
    "compass tilts along, roll right",
    "nose up",
    "accelerometer tilts along, nose up",
    "compass tilts along, nose up",
)
# of the simulated hand: ten seconds, two to rise, four of rest; then it goes to the right
RIGHT_MOVE_S = 16.5
AnySample = ImuSample | MagSample | PadSighting | RangeSample


@lru_cache(maxsize=1)
def right() -> Checked:
    """One check of a vehicle on which all is well."""
    return check()


# ---------------------------------------------------------------- whole


def test_on_a_right_vehicle_all_is_well() -> None:
    checked = right()
    assert checked.report.passed, checked.report.causes
    assert tuple(finding.name for finding in checked.report.findings) == QUESTIONS
    (camera,) = [said.text for said in checked.said if said.text.startswith("camera:")]
    assert re.fullmatch(r"camera: \d\d\.\d frames/s looked at, \d\d ms old on arrival", camera)
    orders = [said.text for said in checked.said if said.kind == "order"]
    assert [
        order for order in orders if order.startswith(("Raise it", "Move", "Turn", "Roll", "Raise its"))
    ] == [step.order for step in STEPS]
    assert "right is right" in verdict_line(checked.report)
    detail = json.loads(report_json(checked.report))
    assert detail["passed"] is True
    assert [row["name"] for row in detail["checks"]] == list(QUESTIONS)
    turned = next(row for row in detail["checks"] if row["name"] == "turn right")["values"]
    assert turned["gyro_rad_z"] == pytest.approx(turned["camera_rad_z"], abs=0.03)


# ---------------------------------------------------------------- on samples


def again(change: Callable[[AnySample], AnySample | None], said: list[Say] | None = None) -> Report:
    """The check over the samples of a right vehicle, as other settings or sensors would have given them."""
    heard = [] if said is None else said
    samples, wizard = RecentSamples(), Wizard(MOUNTING, 0.0)
    takers = {
        ImuSample: samples.add_imu,
        MagSample: samples.add_mag,
        PadSighting: samples.add_sighting,
        RangeSample: samples.add_range,
    }
    next_s = 0.0
    for heard_s, sample in right().heard:
        while heard_s > next_s:
            heard += wizard.step(samples, next_s)
            next_s += 0.1
        changed = change(sample)
        if changed is not None:
            takers[type(changed)](changed)  # type: ignore[operator]
    while not wizard.finished:
        heard += wizard.step(samples, next_s)
        next_s += 0.1
    return wizard.report()


def failed(report: Report) -> set[str]:
    """The names of what is not well."""
    return set(report.causes)


def changed(kind: type[AnySample], **ways: Callable[[Any], Any]) -> Callable[[AnySample], AnySample]:
    """Fields of one kind of samples are otherwise."""

    def change(sample: AnySample) -> AnySample:
        if not isinstance(sample, kind):
            return sample
        return replace(sample, **{name: way(getattr(sample, name)) for name, way in ways.items()})

    return change


def euler(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Quaternion:
    """A rotation by angles in degrees."""
    roll, pitch, yaw = np.radians((roll_deg, pitch_deg, yaw_deg)).tolist()
    return quat_from_euler(roll, pitch, yaw)


def test_the_same_samples_give_the_same_answers() -> None:
    assert again(lambda sample: sample).passed


@pytest.mark.parametrize("wrong_deg", [90.0, 180.0, -90.0, 30.0])
def test_a_camera_turned_on_its_axis(wrong_deg: float) -> None:
    turn = euler(0.0, 0.0, wrong_deg)
    rotated, turned = partial(quat_rotate, turn), partial(quat_multiply, turn)
    report = again(changed(PadSighting, pad_position_body_m=rotated, body_from_pad=turned))
    assert failed(report) >= {"roll right", "nose up"}
    assert failed(report) <= {"right is right", "forward is forward", "roll right", "nose up"}
    (line,) = cause_lines(report)
    fitting = float(line.partition("is 0; ")[2].split()[0])
    # a half turn has two signs
    assert abs(np.sin(0.5 * np.radians(fitting + wrong_deg))) < np.sin(np.radians(2.0))


@pytest.mark.parametrize(
    "wrong_deg", [(0.0, 0.0, 90.0), (180.0, 0.0, 0.0), (90.0, 0.0, 0.0), (0.0, -90.0, 0.0)]
)
def test_a_chip_mounted_otherwise(wrong_deg: Vector3) -> None:
    rotated = partial(quat_rotate, euler(*wrong_deg))
    imu = changed(ImuSample, rate_body_rad_s=rotated, specific_force_body_m_s2=rotated)
    mag = changed(MagSample, field_body_ut=rotated)
    report = again(lambda sample: mag(imu(sample)))
    assert "nose up" in failed(report) or "roll right" in failed(report)
    assert failed(report).isdisjoint({"up is up", "height, low", "compass"})
    causes = {report.causes[name] for name in failed(report)}
    (cause,) = causes
    words = cause.partition("; [")[2].partition("]")[0]
    fitting = euler(*(float(word) for word in words.split(",")))
    # what would fit undoes the turn: the chip is as the shipped settings have it, in the wrong turn's axes
    wrong, shipped = euler(*wrong_deg), euler(180.0, 0.0, 0.0)
    for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
        undone = quat_rotate_inverse(wrong, quat_rotate(shipped, axis))
        assert quat_rotate(fitting, axis) == pytest.approx(undone, abs=1e-6)


@dataclass(frozen=True)
class DistanceError:
    """Scales and offsets of what measures distances."""

    pad: float = 1.0
    echo: float = 1.0
    echo_more_m: float = 0.0

    def __call__(self, sample: AnySample) -> AnySample:
        """A sample as it would come."""
        if isinstance(sample, PadSighting):
            return replace(sample, pad_position_body_m=scale(sample.pad_position_body_m, self.pad))
        if isinstance(sample, RangeSample):
            return replace(sample, distance_m=self.echo * sample.distance_m + self.echo_more_m)
        return sample


@pytest.mark.parametrize(
    ("wrong", "named", "not_named"),
    [
        (DistanceError(pad=1.25), "the printed pad's size", "the ultrasonic's scale"),
        (DistanceError(pad=0.8), "the printed pad's size", "the ultrasonic's scale"),
        (DistanceError(echo=1.3), "the ultrasonic's scale", "the printed pad's size"),
        (DistanceError(echo=0.75), "the ultrasonic's scale", "the printed pad's size"),
        (DistanceError(echo_more_m=0.12), "range_position_body_m", "the printed pad's size"),
    ],
)
def test_heights_that_disagree_are_put_down_to_whom_the_imu_contradicts(
    wrong: DistanceError, named: str, not_named: str
) -> None:
    report = again(wrong)
    assert failed(report) == {"height, low", "height, high"}
    (line,) = cause_lines(report)
    assert named in line
    assert not_named not in line


def test_without_echoes_the_ultrasonic_is_named() -> None:
    report = again(lambda sample: None if isinstance(sample, RangeSample) else sample)
    assert failed(report) == {"height, low", "height, high"}
    assert "sense.range.port" in report.causes["height, low"]


def test_without_a_field_the_compass_is_named() -> None:
    report = again(lambda sample: None if isinstance(sample, MagSample) else sample)
    assert failed(report) == {"compass", "compass turns along"}


def test_a_strong_magnet_is_noticed() -> None:
    report = again(changed(MagSample, field_body_ut=partial(add, (60.0, 0.0, 0.0))))
    assert "compass" in failed(report)
    # of where a disturbed one points nothing is said
    assert not any("COMPASS_ORIENT" in cause for cause in report.causes.values())


TILTS = {"roll right", "nose up"}


@pytest.mark.parametrize("turned_deg", [45.0, 90.0, 180.0])
def test_a_compass_that_sits_turned_on_its_axis_has_every_heading_wrong(turned_deg: float) -> None:
    turn = euler(0.0, 0.0, turned_deg)
    report = again(changed(MagSample, field_body_ut=partial(quat_rotate, turn)))
    # strength, dip and turns about the vertical show nothing of it
    assert failed(report) == {f"compass tilts along, {tilt}" for tilt in TILTS}
    assert "COMPASS_ORIENT" in report.causes["compass tilts along, nose up"]


@pytest.mark.parametrize("factors", [(0.5, 1.0, 1.0), (1.0, 2.0, 1.0), (0.5, 0.5, 0.5), (2.0, 2.0, 2.0)])
def test_an_accelerometer_of_another_range_is_noticed(factors: Vector3) -> None:
    def scaled(force: Vector3) -> tuple[float, ...]:
        return tuple(f * a for f, a in zip(factors, force, strict=True))

    change = changed(ImuSample, specific_force_body_m_s2=scaled)
    wrong = {"level is level"} if len(set(factors)) == 1 else {"accelerometer tilts along, "}
    assert any(name.startswith(tuple(wrong)) for name in failed(again(change)))


def test_no_number_is_no_right_answer() -> None:
    change = changed(ImuSample, specific_force_body_m_s2=lambda _: (float("nan"),) * 3)
    assert "level is level" in failed(again(change))


def test_samples_that_are_lost_at_rest_cost_nothing() -> None:
    """The hand rests from 12 to 16 s."""
    lost_s = RIGHT_MOVE_S - 2.0

    def losing(sample: AnySample) -> AnySample | None:
        return None if isinstance(sample, ImuSample) and lost_s < sample.time_s < lost_s + 0.3 else sample

    said = list[Say]()
    assert again(losing, said).passed
    assert not any("missing" in line.text for line in said)


def test_a_move_that_the_imu_missed_is_asked_for_again_and_another_move_is_no_answer() -> None:
    """The hand does not wait: when "right" is asked for again, it goes forward."""
    moved_s = next(heard_s for heard_s, sample in right().heard if isinstance(sample, PadSighting) and
                   sample.time_s > RIGHT_MOVE_S)  # fmt: skip

    def losing(sample: AnySample) -> AnySample | None:
        lost = isinstance(sample, ImuSample) and moved_s < sample.time_s < moved_s + 0.3
        return None if lost else sample

    said = list[Say]()
    report = again(losing, said)
    assert any("samples of the IMU are missing for 0.3" in line.text for line in said)
    assert "agree on another move" in report.causes["right is right"]
    assert "forward" in next(f.detail for f in report.findings if f.name == "right is right")


def test_moves_that_are_not_made_end_by_time() -> None:
    """Everything stays as in the first seconds, for ever."""
    samples, wizard, now_s = RecentSamples(), Wizard(MOUNTING, 0.0), 0.0
    first = [(heard_s, sample) for heard_s, sample in right().heard if heard_s < 5.0]
    said = []
    while not wizard.finished and now_s < 10.0 * STEP_TIMEOUT_S:
        for _, sample in first:
            shifted = replace(sample, time_s=sample.time_s + now_s)
            {
                ImuSample: samples.add_imu,
                MagSample: samples.add_mag,
                PadSighting: samples.add_sighting,
                RangeSample: samples.add_range,
            }[type(sample)](shifted)  # type: ignore[operator]
        now_s += 5.0
        said += wizard.step(samples, now_s)
    assert wizard.finished
    assert {step.name for step in STEPS} <= failed(wizard.report())
    assert all("not done within" in f.detail for f in wizard.report().findings if f.name == "right is right")
