"""What the page's process begins with, for tests."""

from dataclasses import replace
from typing import Any

import numpy as np

from companion.app.page.look import Look, Start, TrackPoint
from companion.base.messages import Frame
from companion.config import CameraConfig, find_file, load_model, load_vehicle
from companion.pad import load_pad

TOKEN = "a token of enough characters"
START = Start(
    host="127.0.0.1",
    port=0,
    token=None,
    allow_commands=False,
    host_names=("rover.lan",),
    most_viewers=2,
    camera=load_model(CameraConfig, find_file("cameras", "sitl_640x480")),
    vehicle=load_vehicle("x500", None, "sitl_640x480"),
    pad=load_pad("moving_1300"),
    start_unix_s=1.7e9,
    start_s=100.0,
)


def start(**changes: Any) -> Start:
    return replace(START, **changes)


def frame(time_s: float = 101.0, sequence: int = 7) -> Frame:
    image = np.zeros((START.camera.height_px, START.camera.width_px), dtype=np.uint8)
    return Frame(time_s, time_s + 0.03, sequence, image)


def look(**values: Any) -> Look:
    return Look(TrackPoint(102.0, 2.0, 0.1, 2.5), "descend", **values)
