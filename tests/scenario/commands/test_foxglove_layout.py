"""The shipped Foxglove layout over a log as a flight leaves it: each panel finds what it shows."""

import json
import re
from collections.abc import Iterator
from typing import Any, Final

import pytest
from mcap.reader import make_reader

from companion.config import CONFIG_FOLDER
from tests.scenario.flying import SharedFlights

pytestmark = pytest.mark.slow

LAYOUT: Final = json.loads((CONFIG_FOLDER / "foxglove" / "landing.json").read_text())
MODIFIER: Final = re.compile(r"\.@\w+$")  # arithmetic of a plotted path
STEP: Final = re.compile(r"\.(\w+)|\[(\d+)\]")
# what each kind of panel can show
DRAWN_IN_3D: Final = {"foxglove.SceneUpdate", "foxglove.PoseInFrame", "foxglove.CameraCalibration"}
Log = dict[str, tuple[str, list[Any]]]  # by topic: schema and messages


@pytest.fixture(scope="module")
def log(shared_flights: SharedFlights) -> Log:
    record, flown = shared_flights.recorded()
    assert flown.code == 0, flown
    topics: Log = {}
    with (record / "flight.mcap").open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            topics.setdefault(channel.topic, (schema.name, []))[1].append(json.loads(message.data))
    return topics


def panels(part: Any) -> Iterator[dict[str, Any]]:
    if part["type"] == "panel":
        yield part
    for item in part.get("items", ()):
        yield from panels(item["content"])


def of_kind(kind: str) -> list[dict[str, Any]]:
    return [panel["config"] for panel in panels(LAYOUT["content"]) if panel["panelType"] == kind]


def values(log: Log, path: str) -> list[Any]:
    """What a message path gives, of each message that has it.

    Raises:
        KeyError: no such topic.
    """
    topic, _, steps = MODIFIER.sub("", path).partition(".")
    found = []
    for message in log[topic][1]:
        try:
            value = message
            for name, index in STEP.findall("." + steps):
                value = value[name] if name else value[int(index)]
        except (KeyError, IndexError, TypeError):
            continue
        found.append(value)
    return found


def test_it_holds_the_panels_of_a_landing() -> None:
    kinds = [panel["panelType"] for panel in panels(LAYOUT["content"])]
    assert sorted(kinds) == ["Image", "Log", "Plot", "Plot", "StateTransitions", "ThreeDee"]
    assert all(panel["title"] for panel in panels(LAYOUT["content"]))


def test_every_plotted_path_gives_changing_numbers(log: Log) -> None:
    paths = [path["value"] for plot in of_kind("Plot") for path in plot["paths"]]
    assert len(paths) >= 5
    for path in paths:
        numbers = values(log, path)
        assert len(numbers) > 100, path
        assert all(isinstance(number, float | int) for number in numbers), path
        assert len(set(numbers)) > 10, path


def test_the_phases_are_those_of_the_flight(log: Log) -> None:
    (paths,) = (panel["paths"] for panel in of_kind("StateTransitions"))
    for path in paths:
        assert {"search", "approach", "descend", "touchdown", "landed"} <= set(values(log, path["value"]))


def test_every_other_topic_is_of_a_schema_that_its_panel_shows(log: Log) -> None:
    (events,), (view,), (scene,) = of_kind("Log"), of_kind("Image"), of_kind("ThreeDee")
    image = view["imageMode"]
    assert log[events["topicToRender"]][0] == "foxglove.Log"
    assert log[image["imageTopic"]][0] == "foxglove.CompressedImage"
    assert log[image["calibrationTopic"]][0] == "foxglove.CameraCalibration"
    assert {log[topic][0] for topic in image["annotations"]} == {"foxglove.ImageAnnotations"}
    assert {log[topic][0] for topic in scene["topics"]} <= DRAWN_IN_3D


def test_the_3d_view_goes_by_frames_that_are_connected(log: Log) -> None:
    (scene,) = of_kind("ThreeDee")
    parents = {
        message["child_frame_id"]: message["parent_frame_id"]
        for schema, messages in log.values()
        if schema == "foxglove.FrameTransform"
        for message in messages
    }
    used = {scene["followTf"]}
    for topic in scene["topics"]:
        for message in log[topic][1]:
            used |= {entity["frame_id"] for entity in message.get("entities", [message])}
    connected = {scene["fixedFrame"]}
    while reached := {child for child, parent in parents.items() if parent in connected} - connected:
        connected |= reached
    assert used <= connected
