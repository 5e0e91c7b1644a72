"""The estimate starts again on the ground alone, and what became of its inputs is logged."""

import pytest

from companion.app.timing.estimate_watch import EstimateWatch
from companion.base.clock import Clock
from companion.base.messages import AutopilotState, EstimatorInputs, LandedState
from companion.estimate.input_tally import InputTally


class KnownSession:
    def __init__(self, state: AutopilotState) -> None:
        self.state = state


class StarvedEstimator:
    """One that would start again at once."""

    def __init__(self) -> None:
        self.tally, self.recovered = InputTally(), 0

    def recover(self, _: float) -> str:
        self.recovered += 1
        return "GPS refused for 10 s: estimate restarted"


class KeptLog:
    def __init__(self) -> None:
        self.written: list[object] = []

    def write(self, topic: str, message: object, _: float) -> None:
        assert topic == "estimator_inputs"
        self.written.append(message)


class WatchedEstimate:
    def __init__(self, state: AutopilotState) -> None:
        self.said: list[str] = []
        self.estimator, self.log = StarvedEstimator(), KeptLog()
        self.watch = EstimateWatch(
            self.estimator,  # type: ignore[arg-type]
            KnownSession(state),  # type: ignore[arg-type]
            self.log,  # type: ignore[arg-type]
            Clock(),
            lambda kind, text, severity: self.said.append(f"{kind}: {text}"),
        )


@pytest.mark.parametrize(
    ("armed", "landed", "starts"),
    [
        (False, LandedState.ON_GROUND, 1),
        (True, LandedState.ON_GROUND, 0),
        (False, LandedState.UNDEFINED, 0),
        (True, LandedState.IN_AIR, 0),
    ],
)
async def test_the_estimate_starts_again_only_where_nothing_flies_by_it(
    armed: bool, landed: LandedState, starts: int
) -> None:
    watched = WatchedEstimate(AutopilotState(0.0, armed=armed, landed=landed))
    watched.watch.look(1.0)
    assert watched.estimator.recovered == starts
    assert len(watched.said) == starts
    assert [type(message) for message in watched.log.written] == [EstimatorInputs]
