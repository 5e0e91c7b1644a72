"""OpenCV's process-wide settings."""

from __future__ import annotations

import os

import cv2


def prepare_opencv() -> None:
    """One thread, so that detection does not take the cores from the control loop, and repeats exactly."""
    cv2.setNumThreads(1)
    # what OpenCV has to say about a camera that is not there, we say ourselves
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # quiet: and it may name a URL's password
