"""The bench of others' equipment: what is flown, what counts as over the pad, and its bars."""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

import pytest

from benchmarks.campaign import bench_equipment
from benchmarks.campaign.bench_equipment import (
    CASES,
    COVERED,
    KINDS,
    CoveredFlight,
    covered_bar,
    judge,
    longest_within,
    write_flights,
)
from benchmarks.report import BenchReport
from companion.config import CompanionConfig, merge, validate
from sitl.campaign.manifest import CampaignRun
from sitl.campaign.rows import Row
from sitl.scenario.as_built import AS_BELIEVED
from sitl.scenario.scenario import load_scenario
from tests.unit.sitl.campaign.campaign_parts import row
from tests.unit.sitl.firmware.fake_firmware import fake


def test_each_case_is_a_scenario_for_both_autopilots(tmp_path: Path) -> None:
    flights = write_flights((*CASES, *COVERED), None, tmp_path)
    scenarios = {flight.scenario: load_scenario(flight.source) for flight in flights}
    assert len(scenarios) == len(KINDS) * len((*CASES, *COVERED))
    for scenario in scenarios.values():
        validate(CompanionConfig, merge(CompanionConfig().model_dump(), scenario.companion), scenario.name)
    for case in (*CASES, *COVERED):
        flown = {f.seed: f.scenario for f in flights if f.scenario in {case.title(k) for k in KINDS}}
        count = 20 if case.name == "tag" else 5
        assert flown == {seed: case.title(KINDS[seed % 2]) for seed in range(count)}


def test_a_stream_is_late_and_its_delay_is_known_to_ten_milliseconds(tmp_path: Path) -> None:
    late = [
        load_scenario(flight.source)
        for flight in write_flights(CASES, 2, tmp_path)
        if flight.scenario.startswith("network")
    ]
    assert {(s.camera.latency_s, abs(s.camera.stamp_error_s)) for s in late} == {(0.25, 0.01)}
    for scenario in late:
        built = scenario.built(0)
        assert (built.stamp_jitter_s, built.camera_mount_deg) == (0.006, AS_BELIEVED.camera_mount_deg)


@pytest.mark.parametrize(
    ("distances_m", "longest_s"),
    [((3.0, 1.0, 1.4, 1.0, 2.0, 1.0), 2.0), ((1.6, 1.6), 0.0), ((1.0,) * 4, 3.0), ((), 0.0)],
)
def test_over_the_pad_is_a_time_at_once(distances_m: Sequence[float], longest_s: float) -> None:
    assert longest_within([(float(k), d) for k, d in enumerate(distances_m)], 1.5) == longest_s


@pytest.mark.parametrize(
    ("flight", "holds"),
    [
        (CoveredFlight(0.3, 2.5, landed=False), True),
        (CoveredFlight(0.3, 1.9, landed=False), False),
        (CoveredFlight(0.3, 2.5, landed=True), False),
        (CoveredFlight(math.inf, 0.0, landed=False), False),
    ],
)
def test_without_a_camera_it_stays_over_the_pad_and_does_not_land(flight: CoveredFlight, holds: bool) -> None:
    good = CoveredFlight(0.1, 9.0, landed=False)
    assert covered_bar("covered", [good, flight]).holds is holds
    assert not covered_bar("covered", []).holds


def judged(folder: Path, specs: Sequence[object], monkeypatch: pytest.MonkeyPatch, lost: str = "") -> int:
    """Exit status of made-up rows; the case of which the first does not land may be named."""

    def fly(flights: Sequence[CampaignRun], *_: object) -> list[Row]:
        ends = ["timeout" if f.seed == 0 and f.scenario == lost else "landed" for f in flights]
        return [row(f.scenario, f.seed, end) for f, end in zip(flights, ends, strict=True)]

    monkeypatch.setattr(bench_equipment, "fly", fly)
    given = argparse.Namespace(seeds=2, case="tag", jobs=1, out=folder)
    return judge(CASES[:2], specs, given, BenchReport(width=200)).exit_status  # type: ignore[arg-type]


def test_one_that_does_not_land_is_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert judged(tmp_path, [], monkeypatch) == 0
    assert judged(tmp_path, [], monkeypatch, "tag-line-px4") == 1


def test_a_firmware_flies_instead_of_the_bundled_autopilots(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = fake("ardupilot", tmp_path).spec
    flights = write_flights(CASES[:1], 3, tmp_path, [spec])
    assert [(f.scenario, f.seed, f.firmware) for f in flights] == [
        ("tag-ardupilot", seed, spec) for seed in range(3)
    ]
    assert judged(tmp_path, [spec], monkeypatch) == 0
    assert judged(tmp_path, [spec], monkeypatch, "tag-px4") == 0
