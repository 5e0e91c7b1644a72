"""Used and refused samples of each input, with the last reason."""

from __future__ import annotations

from companion.estimate.input_counts import UNUSABLE, InputCount, InputCounts


def test_what_a_gate_refuses_is_not_used_and_the_last_reason_is_kept() -> None:
    counts = InputCounts()
    for taken in (True, True, False, True):
        assert counts.count("gps", taken) is taken
    counts.count("imu", True)
    gates = {"gps_position": 0, "gps_velocity": 0, "orientation": 4}
    assert counts.report(gates) == {"gps": InputCount(3, 1, UNUSABLE), "imu": InputCount(1, 0, "")}
    counts.count("gps", True)
    found = counts.report(gates | {"gps_position": 2})["gps"]
    assert found == InputCount(2, 3, "gps position: off what was expected")
    counts.count("gps", False)
    assert counts.report(gates | {"gps_position": 2})["gps"].reason == UNUSABLE
