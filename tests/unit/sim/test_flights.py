"""The process that flies for a campaign: every request is answered, whatever is asked and whatever fails."""

import io
import json

import pytest

from companion.sim import flights
from companion.sim.flights import Answer, Request, answer


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (b"", "Invalid JSON"),
        (b'{"scenario": "static"}', "seed"),
        (b'{"scenario": "nosuch", "seed": 0}', "scenarios: no 'nosuch'"),
        (b'{"scenario": "static", "seed": 0, "config": "nosuch.yaml"}', "nosuch.yaml: cannot be read"),
    ],
)
def test_a_request_that_cannot_be_flown_is_refused_in_one_line(line: bytes, words: str) -> None:
    refused = answer(line).refused
    assert refused is not None
    assert words in refused
    assert "\n" not in refused


def test_a_fault_of_ours_is_reported_and_shown_in_full(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(_request: Request) -> Answer:
        raise ZeroDivisionError("of a bug")

    monkeypatch.setattr(flights, "fly_request", fails)
    assert answer(b'{"scenario": "static", "seed": 0}') == Answer(fault="ZeroDivisionError: of a bug")
    assert "Traceback" in capsys.readouterr().err


def test_an_answer_has_all_its_keys() -> None:
    said = json.loads(Answer(refused="no").model_dump_json())
    assert said == {"result": None, "reason": "", "touchdown_pad_m": None, "refused": "no", "fault": None}


def test_requests_are_handed_on_until_the_input_ends() -> None:
    told: list[object] = []
    flights._read(io.BytesIO(b"one\ntwo\n"), told.append, told.append)
    assert told == [b"one\n", b"two\n", 0]
