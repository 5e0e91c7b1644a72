"""The live page's bench: without a browser nothing is said to hold."""

from __future__ import annotations

import pytest

from benchmarks.cpu.bench_cpu import CostBar
from benchmarks.service import bench_page


def test_without_chromium_the_delay_is_not_measured_and_the_bench_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench_page, "program", lambda: None)
    assert bench_page.main(["--part", "pixel"]) == 1
    *_, last = capsys.readouterr().out.splitlines()
    assert last == "bars: NOT MEASURED: from exposure to pixel, p50, from exposure to pixel, p99"


@pytest.mark.parametrize(("measured", "status", "last"), [(1.0, 0, "all hold"), (3.0, 1, "FAILED: x")])
def test_the_last_line_says_what_holds(
    measured: float, status: int, last: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert bench_page.report([CostBar("x", measured, 2.0, "ms")]) == status
    assert capsys.readouterr().out.splitlines()[-1] == f"bars: {last}"
