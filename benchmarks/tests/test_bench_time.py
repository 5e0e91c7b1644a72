"""The bench of where the time goes runs, tells the sides apart, and puts an earlier run beside."""

import json
from pathlib import Path

import pytest

from benchmarks.cpu import bench_time
from benchmarks.cpu.bench_time import IMPORTS, ONCE, main, totals
from benchmarks.cpu.cpu_watch import METHODS


def test_a_short_flight_is_measured_and_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench_time, "REAL_TIME_FACTOR", 0.0)  # no test is about how fast this machine is
    first = tmp_path / "first.json"
    short = ["--scenario", "static", "--time-limit", "6"]
    report = main(short)
    assert report.exit_status == 0
    report.write(first, "time", short)
    found = json.loads(first.read_text("utf-8"))["figures"]
    parts = found["parts_ms_per_s"]
    watched = {f"app: {name}" for name in METHODS if name not in ("controller", "fusing GPS")}
    assert watched <= parts.keys()
    assert {"SITL: world", "SITL: rendering", "app: tasks between the stages"} <= parts.keys()
    assert all(spent_ms > 0.0 for name, spent_ms in parts.items() if name in watched)
    sides = totals(found)
    assert sides["app"] > 0.0
    assert sides["SITL"] > 0.0
    assert sides["all"] == pytest.approx(sum(parts.values()))
    assert found["threads_ms_per_s"].keys() == {"MainThread"}
    assert found["once_ms"].keys() == {*ONCE, *IMPORTS}
    assert main([*short, "--against", str(first)]).exit_status == 0
    said = capsys.readouterr().out
    assert "before" in said
    assert "ratio" in said
