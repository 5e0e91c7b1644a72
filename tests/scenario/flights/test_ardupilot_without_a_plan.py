"""An ArduPilot, which is sent attitudes, when the solver finds nothing: its own loops stop it.

Level at hover thrust kept speed and sink here: it touched the ground at 0.74 m/s down, 0.35 m/s sideways.
"""

from benchmarks.faults.cases import FaultRun, scenario_of
from benchmarks.faults.fault_flight import fly, judged


def test_without_a_plan_it_stops_where_it_is() -> None:
    run = FaultRun("MPC NaN", "descend", "line", 1)
    record, config = fly(scenario_of(run).model_copy(update={"autopilot": "ardupilot"}), run.seed)
    assert "control failed" in record.texts[-1].text
    assert judged(run, record, config).unsafe == ()
