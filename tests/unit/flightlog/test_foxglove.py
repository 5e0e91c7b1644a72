"""Foxglove's well-known messages in flight.mcap: by Foxglove's own schemas, and true to the flight."""

import csv
import errno
import json
import math
import os
import subprocess
import sys
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

import cv2
import foxglove.messages
import numpy as np
import pytest
from google.protobuf import descriptor_pb2, json_format, message_factory
from mcap.reader import make_reader

from companion.base import messages as ours
from companion.base.geometry import quat_from_euler, quat_rotate
from companion.base.message_json import decode, encode, schema_of
from companion.base.messages import (
    ControlReport,
    Frame,
    FrameReport,
    GpsFix,
    Notice,
    PadSighting,
    PadState,
    PlanStep,
    Reference,
    VehicleState,
)
from companion.config import (
    CONFIG_FOLDER,
    Box,
    CameraConfig,
    ConfigError,
    Cylinder,
    find_file,
    load_config,
    load_model,
    load_vehicle,
)
from companion.flightlog.foxglove.parts import ENU_FROM_NED
from companion.flightlog.foxglove.schemas import SCHEMAS
from companion.flightlog.foxglove.translator import Translator
from companion.flightlog.record import FlightLog
from companion.flightlog.tables import convert
from companion.pad import load_pad
from tests.unit.flightlog.test_result import pad_at, vehicle_at


def official(name: str) -> Any:
    """The message class that Foxglove's SDK describes."""
    schema = getattr(foxglove.messages, name.removeprefix("foxglove.")).get_schema()
    files = descriptor_pb2.FileDescriptorSet()
    files.ParseFromString(schema.data)
    return message_factory.GetMessages(files.file)[schema.name]


def as_proto(descriptor: Any, plain: Any) -> Any:
    """Our JSON as protobuf's JSON, which differs in the form of times alone."""
    if descriptor is None or not isinstance(plain, dict):
        return plain
    if descriptor.full_name in ("google.protobuf.Timestamp", "google.protobuf.Duration"):
        assert plain.keys() == {"sec", "nsec"}
        assert all(isinstance(number, int) for number in plain.values())
        if descriptor.name == "Duration":
            return f"{plain['sec']}.{plain['nsec']:09d}s"
        return f"2020-01-01T00:00:00.{plain['nsec']:09d}Z"
    out = {}
    for key, value in plain.items():
        assert key in descriptor.fields_by_name, f"{descriptor.full_name} has no {key}"
        inner = descriptor.fields_by_name[key].message_type
        several = isinstance(value, list)
        out[key] = [as_proto(inner, item) for item in value] if several else as_proto(inner, value)
    return out


# ----------------
# Foxglove's well-known messages in flight.mcap: by Foxglove's own schemas, and true to the flight.

START_UNIX_S = 1.7e9
WELL_KNOWN = {
    "/tf/vehicle": "foxglove.FrameTransform",
    "/tf/camera": "foxglove.FrameTransform",
    "/tf/local_ned": "foxglove.FrameTransform",
    "/tf/pad": "foxglove.FrameTransform",
    "/vehicle/pose": "foxglove.PoseInFrame",
    "/pad/pose": "foxglove.PoseInFrame",
    "/scene": "foxglove.SceneUpdate",
    "/location": "foxglove.LocationFix",
    "/camera": "foxglove.CompressedImage",
    "/camera/annotations": "foxglove.ImageAnnotations",
    "/camera/calibration": "foxglove.CameraCalibration",
    "/log": "foxglove.Log",
}
CONFIG = load_config(CONFIG_FOLDER / "companion.yaml")
CAMERA, PAD = load_model(CameraConfig, find_file("cameras", "sitl_640x480")), load_pad("moving_1300")
VEHICLE = load_vehicle("x500", None, "sitl_640x480")
POLE = Cylinder(kind="cylinder", centre_ned_m=(3.0, 1.0), radius_m=0.5, height_m=4.0)
WALL = Box(kind="box", centre_ned_m=(0.0, 0.0), length_m=4.0, width_m=0.5, heading_deg=90.0, height_m=4.0)
# straight under the camera of a level vehicle, 2 m down
SIGHTING = PadSighting(
    1.05,
    7,
    (VEHICLE.camera_position_body_m[0], VEHICLE.camera_position_body_m[1], 2.0),
    (1.0, 0.0, 0.0, 0.0),
    np.eye(6),
    "F",
    tuple(m.id for m in PAD.markers if m.group == "F"),
    {"F": 4},
    0.2,
)


def reference(origin: Any) -> Reference:
    rows = np.zeros((3, 3))
    return Reference(1.0, origin, 0.1, rows, rows, rows, 0.0)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flight")
    log = FlightLog(folder, START_UNIX_S, virtual=True)
    plan = CONFIG.plan.model_copy(update={"obstacles": (POLE, WALL)})
    config = CONFIG.model_copy(update={"plan": plan})
    log.write_settings(config=config, vehicle=VEHICLE, camera=CAMERA, pad=PAD)
    log.write("plan", PlanStep(1.0, "descend", reference("pad"), time_to_go_s=2.0), 1.0)  # type: ignore[arg-type]
    log.write("vehicle", vehicle_at(1.0, 0.0, 0.0), 1.0)
    log.write("pad", pad_at(1.0, 0.0), 1.0)
    report = ControlReport(1.0, True, 9, 0.001, predicted_position_m=np.arange(9.0).reshape(3, 3))
    log.write("control_report", report, 1.0)
    log.write("gps", GpsFix(1.0, 47.0, 8.0, 400.0, (0, 0, 0), 2.0, 3.0, 0.1, 9), 1.1)
    image = np.zeros((CAMERA.height_px, CAMERA.width_px), dtype=np.uint8)
    log.write_frame(Frame(1.04, 1.08, 7, image), 1.1)
    log.write("sighting", SIGHTING, 1.15)
    log.write_frame(Frame(1.34, 1.38, 8, image), 1.4)
    log.write("frame_report", FrameReport(1.34, 1.38, 1.41, 8, {}, False, True), 1.41)
    log.write("frame_report", FrameReport(1.37, 1.41, 1.44, 9, {}, False, True), 1.44)
    log.write("notice", Notice(1.5, "phase", "descend: centred", "warning"), 1.5)
    log.close()
    return folder / "flight.mcap"


def messages(path: Path) -> list[tuple[str, str, dict[str, Any]]]:
    with path.open("rb") as stream:
        return [
            (channel.topic, schema.name, json.loads(message.data))
            for schema, channel, message in make_reader(stream).iter_messages()
            if schema is not None
        ]


def one(path: Path, topic: str) -> dict[str, Any]:
    return next(message for name, _, message in messages(path) if name == topic)


# ---------------------------------------------------------------- by Foxglove's own schemas


def test_every_well_known_topic_decodes_by_foxgloves_own_schema(log: Path) -> None:
    seen = {}
    for topic, name, plain in messages(log):
        if not name.startswith("foxglove."):
            continue
        kind = official(name)
        decoded = json_format.ParseDict(as_proto(kind.DESCRIPTOR, plain), kind())
        assert decoded.IsInitialized()
        seen[topic] = name
    assert seen == WELL_KNOWN


@pytest.mark.parametrize("name", SCHEMAS)
def test_the_schemas_have_foxgloves_fields_and_types(name: str) -> None:
    assert_same(SCHEMAS[name], official(name).DESCRIPTOR)


def assert_same(schema: dict[str, Any], descriptor: Any) -> None:
    kinds = {
        "number": {"double"},
        "integer": {"uint32", "fixed32"},
        "string": {"string", "bytes"},
        "boolean": {"bool"},
    }
    types = {1: "double", 7: "fixed32", 8: "bool", 9: "string", 12: "bytes", 13: "uint32"}
    for key, part in schema["properties"].items():
        field = descriptor.fields_by_name[key]
        inner = part["items"] if part.get("type") == "array" else part
        assert (part.get("type") == "array") == field.is_repeated, key
        if "oneOf" in inner:
            values = {value.name: value.number for value in field.enum_type.values}
            assert {item["title"]: item["const"] for item in inner["oneOf"]} == values
        elif field.message_type is None:
            assert types[field.type] in kinds[inner["type"]], key
            assert (types[field.type] == "bytes") == (inner.get("contentEncoding") == "base64")
        elif inner["title"] in ("time", "duration"):
            assert field.message_type.name == {"time": "Timestamp", "duration": "Duration"}[inner["title"]]
        else:
            assert inner["title"] == field.message_type.full_name
            assert_same(inner, field.message_type)


def readable(schema: dict[str, Any], where: str) -> None:
    """What Foxglove's reader of JSON schemas takes; it refuses a whole channel for anything else."""
    assert schema["type"] == "object", where
    for key, part in schema["properties"].items():
        place = f"{where}.{key}"
        if "oneOf" in part:
            assert all(isinstance(item["const"], int) for item in part["oneOf"]), place
        elif part["type"] == "array":
            assert part["items"]["type"] in ("boolean", "string", "number", "integer", "object"), place
            if part["items"]["type"] == "object":
                readable(part["items"], place)
        elif part["type"] == "object":
            readable(part, place)
        else:
            assert part["type"] in ("boolean", "string", "number", "integer"), place


def is_message(kind: Any) -> bool:
    return is_dataclass(kind) and kind.__module__ == ours.__name__


# a frame is logged as an image, not as a message of ours
OURS = [kind for name, kind in vars(ours).items() if name != "Frame" and is_message(kind)]


@pytest.mark.parametrize("kind", [schema_of(k) for k in OURS], ids=lambda k: k["title"])
def test_the_schema_of_each_message_of_ours_is_one_that_foxglove_reads(kind: dict[str, Any]) -> None:
    readable(kind, kind["title"])
    for name, part in kind["properties"].items():
        if name.endswith(("_m", "_s", "_rad", "_deg", "_px")):
            assert "description" in part, name


@pytest.mark.parametrize("name", SCHEMAS)
def test_the_well_known_schemas_are_ones_that_foxglove_reads(name: str) -> None:
    readable(SCHEMAS[name], name)


# ---------------------------------------------------------------- true to the flight


def xyz(plain: dict[str, float]) -> tuple[float, float, float]:
    return plain["x"], plain["y"], plain["z"]


def test_the_roots_axes_are_east_north_up() -> None:
    assert quat_rotate(ENU_FROM_NED, (1.0, 2.0, 3.0)) == pytest.approx((2.0, 1.0, -3.0))


def test_the_pad_is_where_vehicle_and_relative_position_put_it(log: Path) -> None:
    vehicle, pad = vehicle_at(1.0, 0.0, 0.0), pad_at(1.0, 0.0)
    place = np.add(vehicle.position_ned_m, pad.relative_position_ned_m)
    assert xyz(one(log, "/tf/pad")["translation"]) == pytest.approx(tuple(place))
    assert one(log, "/pad/pose")["frame_id"] == "local_ned"
    turned = one(log, "/tf/vehicle")["rotation"]
    assert (turned["w"], *xyz(turned)) == pytest.approx(vehicle.attitude)


def test_the_scene_holds_pad_path_touchdown_and_obstacles(log: Path) -> None:
    entities = {entity["id"]: entity for entity in one(log, "/scene")["entities"]}
    assert entities.keys() == {"pad", "predicted path", "predicted touchdown", "obstacle 0", "obstacle 1"}
    pad = np.add(vehicle_at(1.0, 0.0, 0.0).position_ned_m, pad_at(1.0, 0.0).relative_position_ned_m)
    # the pad drives north at 1 m/s and the motion ends in 2 s
    ball = entities["predicted touchdown"]["spheres"][0]["pose"]["position"]
    assert xyz(ball) == pytest.approx(tuple(np.add(pad, (2.0, 0.0, 0.0))))
    path = entities["predicted path"]["lines"][0]
    assert xyz(path["pose"]["position"]) == pytest.approx(tuple(pad))
    assert [xyz(point) for point in path["points"]] == [(0, 1, 2), (3, 4, 5), (6, 7, 8)]
    assert xyz(entities["obstacle 0"]["cylinders"][0]["size"]) == (1.0, 1.0, 4.0)
    wall = entities["obstacle 1"]["cubes"][0]
    assert xyz(wall["pose"]["position"]) == (0.0, 0.0, -2.0)
    turn = wall["pose"]["orientation"]
    assert (turn["w"], *xyz(turn)) == pytest.approx(quat_from_euler(0.0, 0.0, math.radians(90.0)))


def test_the_scene_comes_every_sixth_cycle_whenever_the_flight_began() -> None:
    for start_s in (1.7e9, 1764037200.1234567, 1764037200.7654321):
        foxglove, report = Translator(), ControlReport(1.0, True, 9, 0.001)
        stamps_ns = [round(1e9 * (start_s + k / 30.0)) for k in range(61)]
        scenes = [sum(said.topic == "scene" for said in foxglove.message(report, ns)) for ns in stamps_ns]
        assert scenes == [int(k % 6 == 0) for k in range(61)]


def test_markers_are_drawn_where_opencv_projects_them(log: Path) -> None:
    drawn = one(log, "/camera/annotations")
    assert drawn["timestamp"] == one(log, "/camera")["timestamp"]
    assert {text["text"] for text in drawn["texts"]} == {str(i) for i in SIGHTING.marker_ids}
    marker = next(m for m in PAD.markers if m.group == "F")
    depth = 2.0 - VEHICLE.camera_position_body_m[2]
    # a camera that looks down, its image's top ahead: right is y, down in the image is -x
    points = np.array([(y, -x, depth) for x, y, _ in marker.corners_pad_m()])
    matrix = np.array(one(log, "/camera/calibration")["K"]).reshape(3, 3)
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(CAMERA.distortion))
    outline = drawn["points"][1]["points"]
    assert [(p["x"], p["y"]) for p in outline] == [pytest.approx(tuple(uv), abs=0.01) for uv in pixels[:, 0]]


def test_a_frame_without_the_pad_takes_the_annotations_away(log: Path) -> None:
    empty = [m for topic, _, m in messages(log) if topic == "/camera/annotations" and not m["points"]]
    # frame 9 was not logged
    assert [m["timestamp"]["nsec"] for m in empty] == [pytest.approx(340_000_000, abs=1000)]


# ---------------------------------------------------------------- our own messages


def test_rows_are_one_long_array_and_come_back_as_rows() -> None:
    told = ControlReport(1.0, True, 9, 0.001, predicted_position_m=np.arange(9.0).reshape(3, 3))
    plain = json.loads(encode(told))
    assert plain["predicted_position_m"] == list(range(9))
    assert "hover_thrust" not in plain
    again = decode(ControlReport, plain)
    assert again.predicted_position_m.tolist() == told.predicted_position_m.tolist()
    rows = tuple(tuple(float(6 * i + k) for k in range(6)) for i in range(6))
    pad = PadState(1.0, (0, 0, 1), (0, 0, 0), (0, 0, 0), (0, 0, 0), 0.0, 0.0, 0.1, 0.1, 0.9, rows)
    assert len(json.loads(encode(pad))["covariance"]) == 36
    assert decode(PadState, json.loads(encode(pad))) == pad


def test_rows_of_an_older_log_are_read_as_they_are() -> None:
    plain = json.loads(encode(SIGHTING)) | {"covariance": np.eye(6).tolist()}
    assert decode(PadSighting, plain).covariance.tolist() == np.eye(6).tolist()
    old = {"time_s": 0, "solved": True, "iterations": 1, "solve_s": 0.0, "hover_thrust": None}
    report = decode(ControlReport, {**old, "predicted_position_m": [[1, 2, 3], [4, 5, 6]]})
    assert report.hover_thrust is None
    assert report.predicted_position_m.tolist() == [[1, 2, 3], [4, 5, 6]]


def test_a_schema_tells_elements_units_and_axes() -> None:
    properties = schema_of(VehicleState)["properties"]
    assert properties["velocity_ned_m_s"] == {
        "type": "array",
        "items": {"type": "number"},
        "minItems": 3,
        "maxItems": 3,
        "description": "north, east, down; m/s",
    }
    assert properties["origin"]["description"].endswith("left out where it is not known")
    assert "origin" not in schema_of(VehicleState)["required"]
    assert schema_of(PlanStep)["properties"]["actions"]["items"]["title"] == "Action"
    assert "description" in schema_of(PadSighting)["properties"]["covariance"]


# ---------------------------------------------------------------- tables


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_a_log_becomes_tables(log: Path, tmp_path: Path, form: str) -> None:
    words = ("-m", "companion.cli", "logs", "convert", log, "--to", form, "-o", tmp_path / "tables")
    done = subprocess.run((sys.executable, *words), capture_output=True, text=True, check=True, timeout=120)
    assert "tables" in done.stdout
    again = subprocess.run((sys.executable, *words), check=False, capture_output=True, text=True, timeout=120)
    assert (again.returncode, "exists already; expected a new one, by --output" in again.stderr) == (2, True)
    if form == "csv":
        lines = (tmp_path / "tables" / "vehicle.csv").read_text().splitlines()
        row = dict(zip(lines[0].split(","), lines[1].split(","), strict=True))
    else:
        parquet = pytest.importorskip("pyarrow.parquet")
        row = parquet.read_table(tmp_path / "tables" / "vehicle.parquet").to_pylist()[0]
    vehicle = vehicle_at(1.0, 0.0, 0.0)
    assert float(row["velocity_ned_m_s[1]"]) == vehicle.velocity_ned_m_s[1]
    assert float(row["log_time_s"]) == pytest.approx(START_UNIX_S + 1.0)
    assert not (tmp_path / "tables" / f"camera.{form}").exists()


def test_a_full_disk_leaves_no_half_of_a_table(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(csv.DictWriter, "writerows", full)
    with pytest.raises(ConfigError, match="tables: cannot be written: No space left"):
        convert(log, tmp_path / "tables", "csv")
    assert list((tmp_path / "tables").iterdir()) == []
