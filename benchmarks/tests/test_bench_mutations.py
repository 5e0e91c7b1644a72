"""The bench of spoilt inputs finds what is not ours, and goes on; the app has none."""

import random
from collections.abc import Iterator

import pytest

from benchmarks.mutations import bench_mutations
from benchmarks.mutations.bench_mutations import TARGETS, main, run_target
from benchmarks.mutations.targets import NotFiniteError, check_finite, spoiled, spoiled_text, spoiled_tree


@pytest.mark.parametrize("name", sorted(TARGETS))
def test_a_few_spoilt_inputs_raise_nothing(name: str) -> None:
    found = run_target(name, TARGETS[name][0], 400 if "settings" not in name else 40, seed=7)
    assert found.failures == []
    assert found.inputs >= 40


def test_an_exception_is_reported_with_its_seed_and_the_target_begins_anew(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def sometimes(rng: random.Random) -> Iterator[None]:
        while True:
            check_finite(float("nan") if rng.random() < 0.01 else 1.0)
            yield

    monkeypatch.setattr(bench_mutations, "TARGETS", {"x": (sometimes, 1.0)})
    assert main(["--count", "2000"]).exit_status == 1
    said = capsys.readouterr().out
    assert "exceptions that are not ours" in said
    assert "FAILS" in said
    assert "x, seed 0 0, input" in said
    assert "NotFiniteError" in said
    first, again = (run_target("x", sometimes, 2000, seed=3) for _ in range(2))
    assert first.inputs == again.inputs == 2000
    assert first.failures == again.failures != []


def test_memory_that_grows_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = []

    def leaks(rng: random.Random) -> Iterator[None]:
        while True:
            kept.append(rng.randbytes(500_000))
            yield

    monkeypatch.setattr(bench_mutations, "TARGETS", {"x": (leaks, 1.0)})
    assert main(["--count", "400"]).exit_status == 1


def test_mutations_differ_and_come_again_with_their_seed() -> None:
    def made(seed: int) -> list[object]:
        rng = random.Random(seed)
        tree = {"a": {"b": [1, 2.0], "c": "x"}, "d": None}
        return [
            [spoiled(rng, b"0123456789") for _ in range(50)],
            [spoiled_text(rng, "a: 1\nb: [2]\n") for _ in range(50)],
            repr([spoiled_tree(rng, tree) for _ in range(50)]),
        ]

    assert made(1) == made(1) != made(2)
    assert tree_is_left_alone()
    with pytest.raises(NotFiniteError):
        check_finite(1.0, float("inf"))


def tree_is_left_alone() -> bool:
    tree = {"a": {"b": [1, 2.0]}}
    for seed in range(50):
        spoiled_tree(random.Random(seed), tree)
    return tree == {"a": {"b": [1, 2.0]}}
