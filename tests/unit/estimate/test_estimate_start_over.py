"""After a suspension of the machine nothing that was estimated looks old, so the app forgets it by order."""

from tests.unit.estimate.estimate_flight import EstimateFlight, feed, new_estimator


def test_an_estimator_that_starts_over_knows_neither_vehicle_nor_pad() -> None:
    estimator, now_s = new_estimator(), 0.0
    samples = iter(EstimateFlight().samples)
    while estimator.pad(now_s) is None:
        now_s, sample = next(samples)
        feed(estimator, sample)
    vehicle = estimator.vehicle(now_s)
    assert vehicle is not None
    assert vehicle.aligned
    estimator.start_over()
    for _ in range(100):  # half a second in flight: nothing to align by
        now_s, sample = next(samples)
        feed(estimator, sample)
        assert estimator.vehicle(now_s) is None
        assert estimator.pad(now_s) is None
