"""Whose CPU it was: app's and simulator's methods by part, by thread, and the loop's longest callbacks.

A part's share leaves out what watched methods within it take. Time is the thread's CPU time, so that a busy
machine changes nothing but what it does to a CPU second.
"""

import asyncio
import gc
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final, NamedTuple

from companion.control.controller import Controller
from companion.estimate.estimator import StateEstimator
from companion.flightlog.record import FlightLog, _McapFile, _TlogFile
from companion.link.session import Session
from companion.plan.planner import Planner
from companion.sense.gps.neo6m import Neo6m
from companion.sense.imu.mpu9250 import Mpu9250
from companion.sense.range.ultrasonic import Ultrasonic
from companion.sense.vision.pipeline import Vision
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.camera.camera import CameraModel
from sitl.devices.mpu9250 import Mpu9250Device
from sitl.devices.rack import SensorRack
from sitl.mavlink.network import Network
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.world.contact import Contact
from sitl.world.world import World

TASKS: Final = "tasks between the stages"
LOOP: Final = "event loop"
GARBAGE: Final = "garbage collection"
Methods = dict[str, tuple[tuple[type[Any], tuple[str, ...]], ...]]
METHODS: Final[Methods] = {
    "vision": ((Vision, ("step",)),),
    "IMU and EKF": (
        (StateEstimator, ("add_imu", "add_mag", "add_autopilot_attitude", "vehicle", "vehicle_covariance")),
    ),
    "fusing GPS": ((StateEstimator, ("add_gps",)),),
    "pad filter": ((StateEstimator, ("add_sighting", "add_range", "pad", "pad_prior")),),
    "planner": ((Planner, ("step",)),),
    "controller": ((Controller, ("step",)),),
    "link": ((Session, ("receive", "take_samples", "tick", "send_setpoint", "send_notice", "align")),),
    "log": (
        (FlightLog, ("write", "write_frame", "write_mavlink")),
        (_McapFile, ("write", "write_image")),
        (_TlogFile, ("write",)),
    ),
    "drivers": ((Mpu9250, ("poll",)), (Neo6m, ("feed", "pending")), (Ultrasonic, ("feed",))),
}
# of the loop itself; in virtual time its callbacks are the simulator's too
LOOP_METHODS: Final[Methods] = {
    TASKS: ((asyncio.Handle, ("_run",)),),
    LOOP: ((asyncio.BaseEventLoop, ("_run_once",)),),
}
SITL_METHODS: Final[Methods] = {
    "SITL: world": ((World, ("step", "truth")),),
    "SITL: contact": ((Contact, ("step",)),),
    "SITL: autopilot": ((SimulatedAutopilot, ("step",)),),
    "SITL: sensors and devices": (
        (SensorRack, ("step",)),
        (SimulatedAutopilotSensors, ("step",)),
        (Mpu9250Device, ("read", "write")),
    ),
    "SITL: rendering": ((CameraModel, ("_surface", "_node_map", "_draw", "_through_lens", "_expose")),),
    "SITL: MAVLink": ((Network, ("receive", "transmit")),),
}


class Callback(NamedTuple):
    """One turn of the event loop: how long it held the others up, and by which part mostly."""

    cpu_s: float
    part: str


class CpuWatch:
    """Adds up the CPU spent in methods by part, in all threads."""

    def __init__(self, methods: Methods) -> None:
        """`methods` by part; with `LOOP_METHODS` among them the loop's callbacks are told, too."""
        self.spent_s: defaultdict[str, float] = defaultdict(float)
        self.by_thread_s: defaultdict[str, float] = defaultdict(float)
        self.calls: defaultdict[str, int] = defaultdict(int)
        self.longest_s: defaultdict[str, float] = defaultdict(float)
        self.callbacks: list[Callback] = []
        self._methods = methods
        self._lock = threading.RLock()  # a collection may strike while it is held
        self._thread = threading.local()

    @contextmanager
    def watching(self) -> Iterator[None]:
        """While inside, the methods are timed."""
        found = [
            (part, owner, name, getattr(owner, name))
            for part, owners in self._methods.items()
            for owner, names in owners
            for name in names
        ]
        for part, owner, name, method in found:
            setattr(owner, name, self.timed(part, method))
        gc.callbacks.append(self._collecting)
        try:
            yield
        finally:
            gc.callbacks.remove(self._collecting)
            for _, owner, name, method in found:
                setattr(owner, name, method)

    def forget(self) -> None:
        """Begin anew."""
        with self._lock:
            self.spent_s.clear()
            self.by_thread_s.clear()
            self.calls.clear()
            self.longest_s.clear()
            self.callbacks.clear()

    def _collecting(self, phase: str, _info: dict[str, int]) -> None:
        """gc: a collection begins or has ended, in whichever thread it struck."""
        if phase == "start":
            self._frames().append({})
            self._thread.collecting_s = time.thread_time()
        else:
            self._account(GARBAGE, time.thread_time() - self._thread.collecting_s)

    def timed(self, part: str, method: Callable[..., Any]) -> Callable[..., Any]:
        """A function that counts for a part."""

        def timed(*arguments: Any, **named: Any) -> Any:
            inner = self._frames()
            inner.append({})
            started_s = time.thread_time()
            try:
                return method(*arguments, **named)
            finally:
                self._account(part, time.thread_time() - started_s)

        return timed

    def _frames(self) -> list[dict[str, float]]:
        """For each watched method that is running in this thread, what was spent within it, by part."""
        frames: list[dict[str, float]] | None = getattr(self._thread, "frames", None)
        if frames is None:
            frames = self._thread.frames = []
        return frames

    def _account(self, part: str, spent_s: float) -> None:
        frames = self._frames()
        within = frames.pop()
        own_s = spent_s - sum(within.values())
        if frames:
            around = frames[-1]
            for name, share_s in (*within.items(), (part, own_s)):
                around[name] = around.get(name, 0.0) + share_s
        with self._lock:
            self.spent_s[part] += own_s
            self.by_thread_s[threading.current_thread().name] += own_s
            self.calls[part] += 1
            self.longest_s[part] = max(self.longest_s[part], spent_s)
            if part == TASKS:
                within[part] = own_s
                self.callbacks.append(Callback(spent_s, max(within, key=lambda name: within[name])))
