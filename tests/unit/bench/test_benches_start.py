"""Every bench imports and knows its words: a bench that nobody runs dies unseen."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
BENCHES = sorted(path.relative_to(ROOT) for path in (ROOT / "tests" / "bench").rglob("bench_*.py"))


@pytest.mark.parametrize("bench", BENCHES, ids=lambda path: path.stem)
def test_a_bench_says_what_it_is_for(
    bench: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = import_module(".".join(bench.with_suffix("").parts))
    monkeypatch.setattr(sys, "argv", [str(bench), "--help"])
    with pytest.raises(SystemExit) as ended:
        module.main()
    assert ended.value.code == 0
    assert "usage:" in capsys.readouterr().out
