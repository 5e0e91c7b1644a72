"""The bench of mutants: what it changes, which test kills a mutant, and every branch of the gate."""

import ast
from pathlib import Path

import pytest

from benchmarks.mutants import bench_mutants
from benchmarks.mutants.bench_mutants import SOURCE, TESTS, branches_missed, main, mutants, passes

MODULE = '''"""A gate."""

def cut(value: float, most: float = 2.0) -> float:
    """Cut."""
    if value > most:
        return most
    return value if value >= 0.0 else 0.0
'''
WHOLE = """
from companion.control.limits import cut

def test_cut() -> None:
    assert [cut(v) for v in (-1.0, -0.5, 0.0, 1.0, 2.0, 3.0, 4.0)] == [0.0, 0.0, 0.0, 1.0, 2.0, 2.0, 2.0]
"""
WEAK = "from companion.control.limits import cut\n\ndef test_cut() -> None:\n    assert cut(1.0) == 1.0\n"


@pytest.fixture
def tests_of(tmp_path: Path) -> dict[str, str]:
    found = {}
    for name, text in (("whole", WHOLE), ("weak", WEAK)):
        path = tmp_path / f"test_{name}.py"
        path.write_text(text)
        found[name] = str(path)
    return found


def test_each_mutant_is_one_small_change_of_what_runs() -> None:
    made = {mutant.name for mutant in mutants(MODULE)}
    assert "if value > most:: value > most  ->  value >= most" in made
    assert "if value > most:: value > most  ->  value <= most" in made
    assert any(name.endswith(": 2.0  ->  3.0") for name in made)
    assert "return most: return most  ->  return None" in made
    assert any("if True" in name for name in made)
    assert not any("A gate" in name for name in made)
    assert len({ast.unparse(mutant.tree) for mutant in mutants(MODULE)}) == len(list(mutants(MODULE)))


def test_a_mutant_that_a_test_tells_is_killed_and_another_survives(tests_of: dict[str, str]) -> None:
    mutant = next(m for m in mutants(MODULE) if m.name.endswith(": 2.0  ->  3.0"))
    assert passes(ast.parse(MODULE), [tests_of["whole"]])
    assert not passes(mutant.tree, [tests_of["whole"]])
    assert passes(mutant.tree, [tests_of["weak"]])


def test_a_condition_that_was_never_true_or_never_false_is_named(tests_of: dict[str, str]) -> None:
    assert branches_missed(MODULE, [tests_of["whole"]]) == (2, [])
    assert branches_missed(MODULE, [tests_of["weak"]]) == (
        2,
        ["line 5: value > most is never True", "line 7: value >= 0.0 is never False"],
    )


def test_a_survivor_that_nobody_explains_fails_the_bar(
    tests_of: dict[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    source = tmp_path / "limits.py"
    source.write_text("def cut(value: float) -> float:\n    return value + 0.0\n")
    monkeypatch.setattr(bench_mutants, "SOURCE", source)
    monkeypatch.setattr(bench_mutants, "TESTS", (tests_of["weak"],))
    monkeypatch.setattr(bench_mutants, "SURVIVORS", {})
    assert main([]).exit_status == 1
    assert "survivors not explained 1 FAILS" in capsys.readouterr().out
    monkeypatch.setattr(
        bench_mutants, "SURVIVORS", {"return value + 0.0: value + 0.0  ->  value - 0.0": "adds nothing"}
    )
    assert main([]).exit_status == 0


def test_every_condition_of_the_last_gate_is_found_both_true_and_false() -> None:
    count, missed = branches_missed(SOURCE.read_text(encoding="utf-8"), TESTS)
    assert missed == []
    assert count >= 20
