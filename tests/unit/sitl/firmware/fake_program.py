"""Speaks the firmware's side of a lockstep, with nothing of ours: stands in for px4 and arducopter.

`fake_firmware` writes it as a program. It uses the standard library alone, so that it starts at once. How it
behaves is in the file `<program>.json`; what it heard is left beside it, by instance.
"""

import json
import os
import re
import socket
import struct
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import IO, Any, NoReturn

PROGRAM = Path(sys.argv[0])
BEHAVIOUR: dict[str, Any] = {}
LOOPBACK = "127.0.0.1"
LOOK_EVERY = 20
HEARTBEAT, SYS_STATUS, HIL_ACTUATOR_CONTROLS, HIL_SENSOR = 0, 1, 93, 107
EKF_STATUS_REPORT, ESTIMATOR_STATUS, STATUSTEXT = 193, 230, 253
CRC_EXTRA = {
    HEARTBEAT: 50, SYS_STATUS: 124, HIL_ACTUATOR_CONTROLS: 47,
    EKF_STATUS_REPORT: 71, ESTIMATOR_STATUS: 163, STATUSTEXT: 83,
}  # fmt: skip
PREARM_CHECK = 1 << 28
ARMED = 1 << 7
EKF_FLAGS = 0b110011  # attitude, horizontal velocity, absolute position, absolute height


def crc(data: bytes) -> int:
    """CRC-16/MCRF4XX."""
    value = 0xFFFF
    for byte in data:
        low = (byte ^ value) & 0xFF
        low ^= (low << 4) & 0xFF
        value = (value >> 8) ^ (low << 8) ^ (low << 3) ^ (low >> 4)
    return value


def frame(system: int, message_id: int, payload: bytes) -> bytes:
    """A MAVLink 2 frame of component 1."""
    payload = payload.rstrip(b"\0") or b"\0"
    head = struct.pack("<6B", len(payload), 0, 0, 0, system, 1) + message_id.to_bytes(3, "little")
    return b"\xfd" + head + payload + struct.pack("<H", crc(head + payload + bytes([CRC_EXTRA[message_id]])))


class ProgramTelemetry:
    """Its MAVLink over UDP: what tells that it may be armed, and a record of what it is told."""

    def __init__(self, bound: socket.socket, peer: tuple[str, int], system: int, record: IO[bytes]) -> None:
        self.socket, self.peer, self.system, self.record = bound, peer, system, record
        bound.setblocking(False)

    def look(self, estimator: bytes) -> None:
        """Say how it is, and hear."""
        autopilot = 12 if PROGRAM.name == "px4" else 3
        mode = ARMED if BEHAVIOUR["armed"] else 0
        health = PREARM_CHECK if BEHAVIOUR["ready"] else 0
        said = [
            frame(self.system, HEARTBEAT, struct.pack("<I5B", 0, 2, autopilot, mode, 3, 3)),
            frame(self.system, SYS_STATUS, struct.pack("<3I2Hh6Hb", 0, 0, health, *[0] * 9, -1)),
            estimator,
        ]
        if BEHAVIOUR["text"]:
            text = BEHAVIOUR["text"].encode()
            said.append(frame(self.system, STATUSTEXT, struct.pack("<B50sHB", 4, text, 0, 0)))
        for data in said:
            self.socket.sendto(data, self.peer)
        try:
            while True:
                self.record.write(self.socket.recv(4096))
        except BlockingIOError:
            self.record.flush()


def bind(link: socket.socket, port: int) -> None:
    """Once it is free: a test beside this one may have it for a moment, to show that it is passed over."""
    for _ in range(100):
        try:
            return link.bind(("0.0.0.0", port))
        except OSError:
            time.sleep(0.05)
    raise SystemExit(f"port {port} is in use")


def px4() -> None:
    words = sys.argv[1:]
    instance = int(words[words.index("-i") + 1])
    assert Path(words[words.index("-d") + 1]).is_dir()
    note(instance, {name: value for name, value in os.environ.items() if name.startswith("PX4")})
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    bind(link, 14580 + instance)
    simulator = call(4560 + instance)
    system = instance + 1
    estimator = frame(system, ESTIMATOR_STATUS, struct.pack("<Q8fH", 1, *[0.0] * 8, 1))
    with record(instance, "sensors") as sensors, record(instance, "mavlink") as heard:
        telemetry = ProgramTelemetry(link, (LOOPBACK, 14540 + instance), system, heard)
        steps = 0
        for data in frames(simulator):
            sensors.write(data)
            sensors.flush()
            if int.from_bytes(data[7:10], "little") != HIL_SENSOR:
                continue
            steps += 1
            (time_us,) = struct.unpack_from("<Q", data, 10)
            if steps > BEHAVIOUR["boot_steps"] and goes_on(steps):
                controls = [*motors(time_us), *[0.0] * 12]
                simulator.sendall(
                    frame(system, HIL_ACTUATOR_CONTROLS, struct.pack("<2Q16fB", time_us, 0, *controls, 0))
                )
                if steps % LOOK_EVERY == 0:
                    telemetry.look(estimator)


def arducopter() -> None:
    words = sys.argv[1:]
    options = dict(pairwise(words))
    instance = int(options["-I"])
    note(instance, {"parameters": Path(options["--defaults"]).read_text()})
    serial = (5762 + 10 * instance, 5763 + 10 * instance)
    listening.extend(socket.create_server((LOOPBACK, port)) for port in serial)
    host, _, link_port = options["--serial0"].removeprefix("udpclient:").partition(":")
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    address = (options["--sim-address"], int(options["--sim-port-out"]))
    estimator = frame(1, EKF_STATUS_REPORT, struct.pack("<5fHf", *[0.0] * 5, EKF_FLAGS, 0.0))
    with record(instance, "sensors") as sensors, record(instance, "mavlink") as heard:
        telemetry = ProgramTelemetry(link, (host, int(link_port)), 1, heard)
        time_us = 0
        for count in range(10**9):
            if not goes_on(count):
                control.recv(65536)
            pulses = [round(1000 + 1000 * share) for share in motors(time_us)]
            for _ in range(1 + BEHAVIOUR["repeats"]):
                control.sendto(struct.pack("<HHI16H", 18458, 800, count, *pulses, *[0] * 12), address)
            line = control.recv(65536)
            sensors.write(line.strip() + b"\n")
            sensors.flush()
            (stamp,) = re.findall(rb'"timestamp":([0-9.]+)', line)
            time_us = round(1e6 * float(stamp))
            if count >= BEHAVIOUR["boot_steps"] and count % LOOK_EVERY == 0:
                telemetry.look(estimator)


listening: list[socket.socket] = []


def motors(time_us: int) -> list[float]:
    """As the behaviour has them; else the first tells the time that it has been told, in seconds of 10."""
    return BEHAVIOUR["motors"] or [time_us % 10_000_000 / 1e7, 0.0, 0.0, 0.0]


def goes_on(steps: int) -> bool:
    """False once it is to answer no more; it may end instead."""
    if BEHAVIOUR["ends_after"] is not None and steps > BEHAVIOUR["ends_after"]:
        leave(BEHAVIOUR["status"])
    return BEHAVIOUR["silent_after"] is None or steps <= BEHAVIOUR["silent_after"]


def leave(status: int) -> NoReturn:
    print(f"last words\rof {PROGRAM.name}", flush=True)
    sys.exit(status)


def call(port: int) -> socket.socket:
    if BEHAVIOUR["calls"]:
        return socket.create_connection((LOOPBACK, port))
    while True:
        time.sleep(1.0)


def frames(connection: socket.socket) -> Iterator[bytes]:
    """MAVLink 2 frames as they come; a good connection brings nothing else."""
    buffer = b""
    while data := connection.recv(65536):
        buffer += data
        while len(buffer) > 9 and len(buffer) >= (size := 12 + buffer[1]):
            yield buffer[:size]
            buffer = buffer[size:]


def note(instance: int, told: dict[str, str]) -> None:
    """Leave how it was started."""
    started = {"pid": os.getpid(), "folder": str(Path.cwd()), "words": sys.argv[1:], **told}
    path = PROGRAM.with_name(f"{PROGRAM.name}-{instance}.started")
    path.with_suffix(".new").write_text(json.dumps(started))
    path.with_suffix(".new").rename(path)


def record(instance: int, what: str) -> IO[bytes]:
    return PROGRAM.with_name(f"{PROGRAM.name}-{instance}.{what}").open("wb")


def main() -> None:
    BEHAVIOUR.update(json.loads(PROGRAM.with_name(f"{PROGRAM.name}.json").read_text()))
    print(BEHAVIOUR["says"], flush=True)
    if BEHAVIOUR["ends_after"] == -1:
        leave(BEHAVIOUR["status"])
    {"px4": px4, "arducopter": arducopter}[PROGRAM.name]()


if __name__ == "__main__":
    main()
