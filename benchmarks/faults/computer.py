"""The companion computer's own faults, applied to the app from outside: solver, IMU driver, disk.

The app's code is as it flies. What is replaced for the time of a flight is what it calls: the tracker that
the controller is given, the samples that the estimator is handed, and the MCAP library's writer.
"""

import errno
import math
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np
from mcap.writer import Writer

from companion.base.geometry import Vector3
from companion.base.messages import ImuSample
from companion.base.motion import Motion
from companion.control import controller
from companion.control.tracker import Tracker, make_tracker
from companion.control.tracking import SolveOutcome, Target, TrackingSolution
from companion.estimate.estimator import StateEstimator
from sitl.faults.targets import ComputerFaults

NO_NUMBERS: Vector3 = (math.nan, math.nan, math.nan)


class FaultyTracker:
    """A tracker whose solutions fail as the faults say; what it answers then is what `Mpc` answers."""

    def __init__(self, tracker: Tracker, faults: ComputerFaults) -> None:
        self._tracker, self._faults = tracker, faults

    def solve(
        self, start: Motion, target: Target, disturbance_m_s2: Vector3, last_input_m_s2: Vector3
    ) -> TrackingSolution:
        """The tracker's own solution, or a failure."""
        found = self._tracker.solve(start, target, disturbance_m_s2, last_input_m_s2)
        if self._faults.solver == "none":
            return found
        if self._faults.solver == "nan":
            return replace(found, inputs_m_s2=np.full_like(found.inputs_m_s2, math.nan))
        return replace(found, outcome=SolveOutcome.KEPT, late=self._faults.solver == "late")

    def reset(self) -> None:
        """As the tracker's."""
        self._tracker.reset()


@contextmanager
def applied(faults: ComputerFaults) -> Iterator[None]:
    """While inside, the app flies on a computer with these faults."""
    add_imu, add_message = StateEstimator.add_imu, Writer.add_message

    def faulty_tracker(*arguments: Any, **named: Any) -> FaultyTracker:
        return FaultyTracker(make_tracker(*arguments, **named), faults)

    def faulty_imu(estimator: StateEstimator, sample: ImuSample, received_s: float = math.inf) -> bool:
        if faults.imu_nan:
            sample = replace(sample, rate_body_rad_s=NO_NUMBERS, specific_force_body_m_s2=NO_NUMBERS)
        return add_imu(estimator, sample, received_s)

    def faulty_disk(writer: Any, *arguments: Any, **named: Any) -> None:
        if faults.disk_full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if faults.disk_write_s:
            time.sleep(faults.disk_write_s)
        add_message(writer, *arguments, **named)

    with ExitStack() as stack:
        stack.enter_context(mock.patch.object(controller, "make_tracker", faulty_tracker))
        stack.enter_context(mock.patch.object(StateEstimator, "add_imu", faulty_imu))
        stack.enter_context(mock.patch.object(Writer, "add_message", faulty_disk))
        yield
