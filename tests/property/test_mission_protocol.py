"""Whatever is said to the mission protocol, in whatever order, it answers and keeps a list in order."""

import math
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilot.flight.autopilot import PROFILES
from sitl.autopilot.flight.mission_items import Fence, MissionStore
from sitl.mavlink.mission_protocol import MissionProtocol

SMALL = st.integers(0, 4)
NUMBERS = st.sampled_from([0.0, 1.0, -1.0, 5.0, 90.0, 1e30, -1e30, math.nan, math.inf])
COMMANDS = st.sampled_from([16, 17, 18, 19, 20, 21, 22, 93, 112, 115, 177, 178, 189, 5001, 5003, 42_000])
TYPES = st.sampled_from([0, 0, 0, 0, 1, 2, 255, 7])


def items(kind: Any, place: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    frame = st.sampled_from([0, 2, 3, 6, 10])
    return st.builds(
        kind, st.just(1), st.just(1), SMALL, frame, COMMANDS, st.just(0), st.just(1),
        NUMBERS, NUMBERS, NUMBERS, NUMBERS, place, place, NUMBERS, TYPES,
    )  # fmt: skip


ONE = st.just(1)
MESSAGES = st.one_of(
    st.builds(mavlink.MAVLink_mission_count_message, ONE, ONE, SMALL, TYPES),
    items(mavlink.MAVLink_mission_item_int_message, st.integers(-(2**31), 2**31 - 1)),
    items(mavlink.MAVLink_mission_item_message, NUMBERS),
    st.builds(mavlink.MAVLink_mission_request_list_message, ONE, ONE, TYPES),
    st.builds(mavlink.MAVLink_mission_request_message, ONE, ONE, SMALL, TYPES),
    st.builds(mavlink.MAVLink_mission_request_int_message, ONE, ONE, SMALL, TYPES),
    st.builds(mavlink.MAVLink_mission_clear_all_message, ONE, ONE, TYPES),
    st.builds(mavlink.MAVLink_mission_set_current_message, ONE, ONE, SMALL),
    st.builds(mavlink.MAVLink_mission_ack_message, ONE, ONE, st.sampled_from([0, 1, 15]), TYPES),
    st.builds(
        mavlink.MAVLink_mission_write_partial_list_message,
        ONE, ONE, st.integers(-1, 4), st.integers(-1, 4), TYPES,
    ),
)  # fmt: skip
MANNER = st.sampled_from(["px4", "ardupilot"])
LOSSES = st.lists(st.booleans(), max_size=30)
Steps = list[tuple[Any, int, float]]
STEPS = st.lists(st.tuples(MESSAGES, st.integers(0, 1), st.floats(0.0, 3.0)), max_size=40)


@settings(max_examples=60, deadline=None)
@given(autopilot_kind=MANNER, steps=STEPS)
def test_any_conversation_over_two_links_is_survived(autopilot_kind: Any, steps: Steps) -> None:
    store = MissionStore(PROFILES[autopilot_kind].mission)
    fence = Fence(unite=True)
    links = (MissionProtocol(store, fence), MissionProtocol(store, fence))
    us, now_s = mavlink.MAVLink(None, srcSystem=255, srcComponent=190), 0.0
    for message, index, later_s in steps:
        now_s += later_s
        heard = mavlink.MAVLink(None).parse_buffer(bytes(message.pack(us)))[0]
        answers = links[index].handle(heard, now_s)
        for link in links:
            answers += link.due(now_s)
        assert all(bytes(answer.pack(us)) for answer in answers)
        assert 0 <= store.current < max(1, len(store))
        assert len(store) <= 5
        assert len(fence.items) <= 5


@settings(max_examples=40, deadline=None)
@given(autopilot_kind=MANNER, count=st.integers(1, 4), lost=LOSSES)
def test_an_upload_with_losses_ends_complete_or_is_given_up(
    autopilot_kind: Any, count: int, lost: list[bool]
) -> None:
    store = MissionStore(PROFILES[autopilot_kind].mission)
    link = MissionProtocol(store, Fence(unite=True))
    us, now_s = mavlink.MAVLink(None, srcSystem=255, srcComponent=190), 0.0
    drops = iter(lost)
    waiting: Any = mavlink.MAVLink_mission_count_message(1, 1, count, 0)
    for _ in range(80):
        now_s += 0.3
        answers = link.due(now_s)
        if waiting is not None and not next(drops, False):
            heard = mavlink.MAVLink(None).parse_buffer(bytes(waiting.pack(us)))[0]
            answers += link.handle(heard, now_s)
        if any(answer.get_type() == "MISSION_ACK" and answer.type == 0 for answer in answers):
            break
        for answer in answers:
            if answer.get_type().startswith("MISSION_REQUEST"):
                waiting = mavlink.MAVLink_mission_item_int_message(
                    1, 1, answer.seq, 6, 16, 0, 1, 0, 0, 0, 0, 470_000_000, 80_000_000, 5.0 + answer.seq, 0
                )
    heights, whole = [item.z for item in store.items], [5.0 + number for number in range(count)]
    # only an autopilot that writes in place may be left with a part
    assert heights in ([], whole) or (autopilot_kind == "ardupilot" and heights == whole[: len(heights)])
    if not any(lost):
        assert len(store) == count
