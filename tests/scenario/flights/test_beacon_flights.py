"""A pad with a GPS of its own: that leads to it and carries its estimate, and lands nothing by itself."""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

from companion.base.messages import Outcome, Phase
from companion.config import SearchConfig
from tests.scenario.flying import FEW_PICTURES, fly_logged, notices, scenario_file

RTK: dict[str, Any] = {"sensors": {"gps_noise_factor": 0.1}, "beacon": {"position_std_m": 0.02}}
RTK_SETTINGS = {"gps_position_noise_m": 0.1, "gps_accuracy_factor": 0.03}


def test_a_beacon_leads_to_a_pad_that_the_camera_then_lands_on(tmp_path: Path) -> None:
    flight, log = fly_logged(scenario_file(tmp_path, "beacon", FEW_PICTURES))
    assert flight.report.outcome is Outcome.LANDED, flight.report.failures
    # found, lost as the lens was capped, kept by its beacon, and found again
    phases = [step.phase for step in log.kept["plan"]]
    entered = [b for a, b in pairwise(phases) if a is not b]
    assert entered.count(Phase.APPROACH) == 2
    assert "by its beacon" in notices(log)
    blind = [truth for truth in flight.report.truth if 27.0 < truth.time_s < 29.0]
    apart_m = [math.dist(t.vehicle_position_ned_m[:2], t.pad_position_ned_m[:2]) for t in blind]
    assert max(apart_m) < 2.5


def test_without_the_camera_it_waits_over_the_pad_and_does_not_land(tmp_path: Path) -> None:
    changes: dict[str, Any] = {
        **FEW_PICTURES,
        **RTK,
        "time_limit_s": 45.0,
        "pad": {"motion": {"speed_m_s": 0.3}},
        "faults": [{"kind": "pad_covered", "start_s": 0.0}],
        "companion": {"estimate": {"ekf": RTK_SETTINGS}},
    }
    flight, log = fly_logged(scenario_file(tmp_path, "beacon", changes))
    assert flight.report.outcome is Outcome.TIMEOUT
    assert log.kept["plan"][-1].phase is Phase.SEARCH
    assert [notice.text for notice in log.kept["notice"] if notice.kind == "commit"] == []
    late = [truth for truth in flight.report.truth if truth.time_s > 24.0]
    apart_m = [math.dist(t.vehicle_position_ned_m[:2], t.pad_position_ned_m[:2]) for t in late]
    # it comes over the pad, looks round it, and comes back
    assert min(apart_m) < 1.5
    assert max(apart_m) < math.sqrt(2.0) * SearchConfig().spacing_m + 1.5
    assert min(-t.vehicle_position_ned_m[2] for t in late) > 5.0
