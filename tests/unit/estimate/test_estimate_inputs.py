"""What became of each input is counted with its reason, and a filter that refuses all of one starts again."""

import math
from dataclasses import replace

import pytest

from companion.base.geometry import yaw_from_quat
from companion.base.magnetic_field import field_here
from companion.base.messages import GpsFix, ImuSample, InputUse, MagSample
from companion.config import EstimateConfig, VehicleConfig, find_file, load_model
from companion.estimate.ahrs.orientation import heading_noise_rad
from companion.estimate.estimator import StateEstimator
from companion.estimate.input_tally import STARVED_S

FIX = GpsFix(
    time_s=0.0,
    latitude_deg=47.3,
    longitude_deg=8.5,
    altitude_m=400.0,
    velocity_ned_m_s=(0.0, 0.0, 0.0),
    horizontal_accuracy_m=2.5,
    vertical_accuracy_m=3.5,
    speed_accuracy_m_s=0.3,
    satellites=9,
)


class VehicleAtRest:
    """A vehicle that stands: IMU at 100 Hz, field at 50 Hz, fixes at 5 Hz."""

    def __init__(self) -> None:
        config = EstimateConfig()
        vehicle = load_model(VehicleConfig, find_file("vehicles", "px4_500mm"))
        self.estimator = StateEstimator(config, vehicle, (0.0, 0.0, 0.0), 0.5)
        self.field_ut = field_here((FIX.latitude_deg, FIX.longitude_deg, FIX.altitude_m))
        self.time_s = 0.0
        self.said: list[str] = []

    def stand(self, seconds: float, fix: GpsFix | None = FIX, ahead_s: float = 0.0) -> None:
        for k in range(round(100 * seconds)):
            self.time_s += 0.01
            self.estimator.add_imu(ImuSample(self.time_s, (0.0, 0.0, 0.0), (0.0, 0.0, -9.81), 25.0))
            if k % 2 == 0:
                self.estimator.add_mag(MagSample(self.time_s, self.field_ut))
            if k % 20 == 0 and fix is not None:
                self.estimator.add_gps(replace(fix, time_s=self.time_s + ahead_s))
            if k % 100 == 0 and (said := self.estimator.recover(self.time_s)) is not None:
                self.said.append(said)

    def use(self, name: str) -> InputUse:
        return next(use for use in self.estimator.tally.uses() if use.name == name)


@pytest.fixture
def ground() -> VehicleAtRest:
    ground = VehicleAtRest()
    ground.stand(8.0)
    return ground


def test_used_and_refused_are_counted_with_the_last_reason(ground: VehicleAtRest) -> None:
    before = ground.use("gps")
    assert before.used > 10
    assert before.refused_in_a_row == 0
    ground.stand(2.0, ahead_s=0.4)
    after = ground.use("gps")
    assert after.used == before.used
    assert after.refused == before.refused + 10
    assert after.refused_in_a_row == 10
    assert after.reason == "stamped 0.4 s ahead of the IMU"
    ground.stand(1.0, replace(FIX, velocity_ned_m_s=(float("nan"), 0.0, 0.0)))
    assert ground.use("gps").reason == "not a finite number"


def test_a_refusal_by_the_innovation_test_is_counted(ground: VehicleAtRest) -> None:
    ground.stand(0.2, replace(FIX, velocity_ned_m_s=(40.0, 0.0, 0.0)))
    assert ground.use("gps").refused_in_a_row == 1
    assert "innovation test: gps_velocity" in ground.use("gps").reason


def test_a_filter_that_refuses_every_fix_on_the_ground_starts_again(ground: VehicleAtRest) -> None:
    # as if a false stamp of the IMU's were believed: every fix is older than what is remembered
    origin = ground.estimator.vehicle(ground.time_s)
    assert origin is not None
    ground.stand(STARVED_S + 4.0, ahead_s=-30.0)
    assert len(ground.said) == 1
    assert "GPS refused for" in ground.said[0]
    assert "older than what is remembered" in ground.said[0]
    ground.stand(8.0)
    vehicle = ground.estimator.vehicle(ground.time_s)
    assert vehicle is not None
    assert vehicle.origin == origin.origin
    assert ground.use("gps").refused_in_a_row == 0
    assert vehicle.velocity_std_m_s < 0.5


def test_an_imu_that_is_refused_for_its_stamps_starts_the_estimate_again(ground: VehicleAtRest) -> None:
    ground.time_s -= 100.0  # the clock of its stamps was set back
    ground.stand(STARVED_S + 4.0)
    assert len(ground.said) == 1
    assert ground.said[0].startswith("IMU refused")
    ground.stand(8.0)
    assert ground.estimator.vehicle(ground.time_s) is not None


def test_fixes_before_the_alignment_start_nothing_again() -> None:
    ground = VehicleAtRest()
    for second in range(30):
        ground.estimator.add_gps(replace(FIX, time_s=float(second)))
        assert ground.estimator.recover(float(second)) is None


CAPE_TOWN = replace(FIX, latitude_deg=-33.92, longitude_deg=18.42)  # declination -27 deg


def heading_deg(vehicle: VehicleAtRest) -> float:
    state = vehicle.estimator.vehicle(vehicle.time_s)
    assert state is not None
    return math.degrees(yaw_from_quat(state.attitude))


@pytest.mark.parametrize("later_s", [0.0, 5.0])
def test_the_first_fix_tells_the_declination_of_the_place(later_s: float) -> None:
    """It points north in Cape Town's field; nobody has told it where that is."""
    ground = VehicleAtRest()
    ground.field_ut = field_here((CAPE_TOWN.latitude_deg, CAPE_TOWN.longitude_deg, CAPE_TOWN.altitude_m))
    ground.stand(later_s, fix=None)
    ground.stand(8.0, fix=CAPE_TOWN)
    assert heading_deg(ground) == pytest.approx(0.0, abs=0.5)


def test_without_a_fix_it_counts_from_magnetic_north_and_does_not_claim_to_know_better() -> None:
    ground = VehicleAtRest()
    ground.field_ut = field_here((CAPE_TOWN.latitude_deg, CAPE_TOWN.longitude_deg, CAPE_TOWN.altitude_m))
    ground.stand(8.0, fix=None)
    assert heading_deg(ground) == pytest.approx(27.0, abs=1.0)
    covariance = ground.estimator.vehicle_covariance()
    assert covariance is not None
    assert math.degrees(math.sqrt(covariance[2, 2])) > 14.0


def test_a_weak_horizontal_field_tells_little_of_the_heading() -> None:
    """A disturbance that the gate lets pass turns it the further the weaker the field is."""
    zurich, near_the_pole = (
        math.degrees(heading_noise_rad(field, mag_trusted=True, settled=True))
        for field in ((20.9, 0.6, 42.9), (3.6, -0.6, -66.8))
    )
    assert zurich == pytest.approx(18.9, abs=0.1)
    assert near_the_pole > 65.0
