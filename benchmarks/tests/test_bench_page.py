"""The live page's bench: without a browser nothing is said to hold."""

import pytest

from benchmarks.service import bench_page


def test_without_chromium_the_delay_is_not_measured_and_the_bench_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench_page, "program", lambda: None)
    assert bench_page.main(["--part", "pixel"]).exit_status == 1
    *_, last = capsys.readouterr().out.splitlines()
    assert last == "bars: from exposure to pixel, p50 NOT MEASURED, from exposure to pixel, p99 NOT MEASURED"
