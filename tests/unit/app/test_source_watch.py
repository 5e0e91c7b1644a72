"""What is announced of the second sources: the magnetic field that is set, where the first fix shows us."""

from companion.app.stages import SourceWatch
from companion.base.geometry import Vector3
from companion.base.magnetic_field import field_ned_ut
from companion.base.messages import Quantity, SourceComparison
from companion.base.second_sources import OLDEST_S, ROWS, current, refused
from companion.config import EstimateConfig, LinkConfig, load_vehicle
from companion.estimate.estimator import StateEstimator
from companion.link.codec import Severity
from companion.link.session import Session
from companion.plan.landing.standing_height import StandingHeight

CAPE_TOWN = (-33.9, 18.4, 20.0)
VEHICLE = load_vehicle("x500", None, "sitl_640x480")


class Placed(StateEstimator):
    """One whose first fix and comparisons are given."""

    place: Vector3 | None = None
    found: tuple[SourceComparison, ...] = ()

    @property
    def origin(self) -> Vector3 | None:
        return self.place

    @property
    def comparisons(self) -> tuple[SourceComparison, ...]:
        return self.found


def watch(config: EstimateConfig, told: list[str]) -> tuple[Placed, SourceWatch]:
    estimator = Placed(config, VEHICLE, (0.0, 0.0, 0.0), 0.65)
    standing = StandingHeight(VEHICLE)

    def notify(kind: str, text: str, severity: Severity) -> None:
        told.append(text)

    return estimator, SourceWatch(estimator, Session(LinkConfig()), standing, config, VEHICLE, notify)


def test_a_field_of_another_place_is_announced_once_a_fix_is_there_and_not_refused() -> None:
    told = list[str]()
    estimator, sources = watch(EstimateConfig(magnetic_field_ned_ut=(20.9, 0.6, 42.9)), told)
    assert not sources.look(0.0)
    estimator.place = CAPE_TOWN
    (found,) = sources.look(0.0)
    assert found.quantity is Quantity.DECLINATION
    assert not list(refused([found]))
    assert sources.look(0.0) == (found,)
    (text,) = told
    assert text.startswith("magnetic declination: magnetic_field_ned_ut 1.6 deg, ")
    assert text.endswith(" apart: remove estimate.magnetic_field_ned_ut: the app then uses the model")
    sources.begin()
    sources.look(0.0)
    assert told == [text, text]


def test_the_field_of_the_place_is_compared_and_goes_unsaid() -> None:
    told = list[str]()
    config = EstimateConfig(magnetic_field_ned_ut=field_ned_ut(*CAPE_TOWN, 2026.0))
    estimator, sources = watch(config, told)
    estimator.place = CAPE_TOWN
    assert [found.quantity for found in sources.look(0.0)] == [Quantity.DECLINATION]
    assert told == []


def test_a_comparison_of_what_changes_counts_for_a_moment_and_one_of_what_is_built_stays() -> None:
    found = [SourceComparison(10.0, row.quantity, "1", "2", 1.0, 0.0) for row in ROWS]
    assert current(found, 10.0 + OLDEST_S) == tuple(found)
    left = {comparison.quantity for comparison in current(found, 10.1 + OLDEST_S)}
    moment = {Quantity.ATTITUDE, Quantity.HEADING, Quantity.VELOCITY, Quantity.IMU_DELAY, Quantity.LINK_DELAY}
    assert not left & moment
    built = {Quantity.LEG_HEIGHT, Quantity.PAD_SCALE, Quantity.CAMERA_ROTATION, Quantity.DECLINATION}
    assert left >= built


def test_the_autopilots_attitude_is_not_compared_any_more_once_it_is_silent() -> None:
    told = list[str]()
    estimator, sources = watch(EstimateConfig(), told)
    old = SourceComparison(3.0, Quantity.HEADING, "10 deg", "90 deg", 80.0, 1.0)
    estimator.found = (old,)
    assert sources.look(3.1) == (old,)
    assert sources.comparisons(3.1) == (old,)
    assert sources.look(600.0) == sources.comparisons(600.0) == ()
