"""A flight with faults of the pad's sensors lands, and its stream repeats it without flying."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.state.samples import rms
from benchmarks.state.streams import (
    INPUTS,
    Stream,
    feed,
    fly_stream,
    load,
    new_estimator,
    rerun,
    save,
    settings_of,
)
from companion.sim.trial import Trial
from sitl.faults.faults import FrameLate, FrameLost, RangeSpikes
from tests.scenario.flying import FEW_PICTURES

pytestmark = pytest.mark.slow

LATE_S = 0.25
FAULTS = (
    FrameLate(kind="frame_late", start_s=15.0, duration_s=8.0, extra_s=LATE_S, every=5),
    FrameLost(kind="frame_lost", start_s=19.0, duration_s=4.0, share=0.2),
    RangeSpikes(kind="range_spikes", start_s=20.0, share=0.3),
)


@pytest.fixture(scope="module")
def stream() -> Stream:
    trial = Trial.load("static", 0)
    camera = trial.scenario.camera.model_copy(update=FEW_PICTURES["camera"])
    changed = trial.scenario.model_copy(update={"faults": FAULTS, "camera": camera})
    return fly_stream(Trial(trial.path, changed, trial.seed))


def test_it_lands_in_spite_of_late_and_lost_frames_and_wrong_echoes(stream: Stream) -> None:
    assert (stream.outcome, stream.failures) == ("landed", ())
    ages_s = [e.arrival_s - e.message.time_s for e in stream.events if e.topic == "sighting"]
    assert sum(age_s > LATE_S for age_s in ages_s) > 10


def test_its_stream_gives_the_answers_that_flew_to_the_bit_also_from_disk(
    stream: Stream, tmp_path: Path
) -> None:
    save(stream, tmp_path / "static_0.pickle")
    kept = load(tmp_path / "static_0.pickle")
    estimator = new_estimator(settings_of(Trial.load("static", 0)))
    answers = 0
    for event in kept.events:
        if event.topic in INPUTS:
            feed(estimator, event)
        else:
            ask = estimator.vehicle if event.topic == "vehicle" else estimator.pad
            assert ask(event.arrival_s) == event.message
            answers += 1
    assert answers > 1000


def test_samples_are_in_the_air_and_carry_covariances_of_their_size(stream: Stream) -> None:
    samples = rerun(stream)
    air = samples.where(samples.airborne)
    # arming takes 4 s, the flight less than a minute
    assert 4.0 < air.time_s[0] < air.time_s[-1] < 60.0
    assert air.time_s[1:] - air.time_s[:-1] == pytest.approx(0.1, abs=0.03)
    assert rms(air.attitude_deg) < 4.0
    assert rms(air.velocity_m_s) < 0.3
    assert np.linalg.eigvalsh(air.covariance).min() > -1e-12
    seen = air.where(air.seen_for_s > 2.0)
    assert len(seen.time_s) > 50
    assert np.linalg.eigvalsh(seen.pad_covariance).min() > -1e-12
