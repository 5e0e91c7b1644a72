"""What is announced of the second sources: the magnetic field that is set, where the first fix shows us."""

from companion.app.stages import SourceWatch
from companion.base.geometry import Vector3
from companion.base.magnetic_field import field_ned_ut
from companion.base.messages import Quantity
from companion.base.second_sources import refused
from companion.config import EstimateConfig, LinkConfig, load_vehicle
from companion.estimate.estimator import StateEstimator
from companion.link.codec import Severity
from companion.link.session import Session
from companion.plan.landing.standing_height import StandingHeight

CAPE_TOWN = (-33.9, 18.4, 20.0)
VEHICLE = load_vehicle("x500", None, "sitl_640x480")


class Placed(StateEstimator):
    """One whose first fix is given."""

    place: Vector3 | None = None

    @property
    def origin(self) -> Vector3 | None:
        return self.place


def watch(config: EstimateConfig, told: list[str]) -> tuple[Placed, SourceWatch]:
    estimator = Placed(config, VEHICLE, (0.0, 0.0, 0.0), 0.65)
    standing = StandingHeight(VEHICLE)

    def notify(kind: str, text: str, severity: Severity) -> None:
        told.append(text)

    return estimator, SourceWatch(estimator, Session(LinkConfig()), standing, config, VEHICLE, notify)


def test_a_field_of_another_place_is_announced_once_a_fix_is_there_and_not_refused() -> None:
    told = list[str]()
    estimator, sources = watch(EstimateConfig(magnetic_field_ned_ut=(20.9, 0.6, 42.9)), told)
    assert not sources.look()
    estimator.place = CAPE_TOWN
    (found,) = sources.look()
    assert found.quantity is Quantity.DECLINATION
    assert not list(refused([found]))
    assert sources.look() == (found,)
    (text,) = told
    assert text.startswith("magnetic declination: magnetic_field_ned_ut 1.6 deg, ")
    assert text.endswith(" apart: remove estimate.magnetic_field_ned_ut: the app then uses the model")
    sources.begin()
    sources.look()
    assert told == [text, text]


def test_the_field_of_the_place_is_compared_and_goes_unsaid() -> None:
    told = list[str]()
    config = EstimateConfig(magnetic_field_ned_ut=field_ned_ut(*CAPE_TOWN, 2026.0))
    estimator, sources = watch(config, told)
    estimator.place = CAPE_TOWN
    assert [found.quantity for found in sources.look()] == [Quantity.DECLINATION]
    assert told == []
