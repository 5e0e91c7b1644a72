"""Where to look for which markers."""

from dataclasses import replace

import numpy as np
import pytest

from companion.base.messages import MarkerGroup
from companion.config import CameraConfig, VisionConfig
from companion.pad import Pad
from companion.sense.vision.aruco import GROUPS, SearchPass
from companion.sense.vision.lens import Lens
from companion.sense.vision.search import SearchPlanner


@pytest.fixture
def planner(pad: Pad, camera: CameraConfig) -> SearchPlanner:
    return SearchPlanner(pad, Lens(camera), VisionConfig())


@pytest.mark.parametrize(
    ("height_m", "groups", "shrink"),
    [
        (10.0, ["F"], 1),
        (7.0, ["F"], 1),
        (3.0, ["F", "M"], 3),
        (1.0, ["M", "C"], 2),
        (0.3, ["C"], 2),
        (0.1, ["C"], 6),
    ],
)
def test_the_groups_hand_over_with_the_height_and_overlap(
    planner: SearchPlanner, height_m: float, groups: list[str], shrink: int
) -> None:
    looks = planner.expected(np.eye(3), np.array([0.0, 0.0, height_m]), 0.01 * height_m)
    assert [look.groups[0] for look in looks] == groups
    assert looks[0].shrink == shrink


def test_the_region_holds_the_markers_and_grows_with_the_uncertainty(planner: SearchPlanner) -> None:
    position = np.array([0.5, -0.3, 6.0])
    sure = planner.expected(np.eye(3), position, 0.02)[0]
    unsure = planner.expected(np.eye(3), position, 0.3)[0]
    # the outer corners of F are 0.6 m from the centre: 53 px at 6 m
    assert sure.left < 321 + 44 - 53 < 321 + 44 + 53 < sure.right
    assert sure.top < 238 - 27 - 53 < 238 - 27 + 53 < sure.bottom
    assert unsure.left < sure.left - 50
    assert unsure.bottom > sure.bottom + 50


def test_a_region_never_leaves_the_frame(planner: SearchPlanner) -> None:
    for x in (-3.0, 0.0, 3.0):
        for look in planner.expected(np.eye(3), np.array([x, 0.5 * x, 6.0]), 1.0):
            assert 0 <= look.left < look.right <= 640
            assert 0 <= look.top < look.bottom <= 480


def test_a_vague_or_invisible_pad_is_not_expected_anywhere(planner: SearchPlanner) -> None:
    assert planner.expected(np.eye(3), np.array([0.0, 0.0, 4.0]), 2.0) == ()
    assert planner.expected(np.eye(3), np.array([20.0, 0.0, 4.0]), 0.1) == ()
    assert planner.expected(np.eye(3), np.array([0.0, 0.0, -4.0]), 0.1) == ()


def test_widening_reaches_the_whole_frame_once(planner: SearchPlanner) -> None:
    look = planner.expected(np.eye(3), np.array([0.0, 0.0, 6.0]), 0.05)[0]
    (wide,) = planner.widened(look)
    assert (wide.left, wide.top, wide.right, wide.bottom) == (0, 0, 640, 480)
    assert (wide.shrink, wide.groups) == (look.shrink, look.groups)
    assert planner.widened(wide) == ()


def test_what_was_shrunk_much_is_looked_at_more_closely_after_a_look_in_vain(planner: SearchPlanner) -> None:
    for shrink, closer in ((6, (3, 2)), (4, (2,)), (3, (2,))):
        look = SearchPass(0, 0, 640, 480, shrink, ("F",))
        assert planner.widened(look) == tuple(SearchPass(0, 0, 640, 480, s, ("F",)) for s in closer)
    assert planner.widened(SearchPass(0, 0, 640, 480, 2, ("F", "M"))) == ()


def test_larger_markers_that_were_not_expected_are_looked_for_after_a_look_in_vain(
    planner: SearchPlanner,
) -> None:
    cases: list[tuple[MarkerGroup, tuple[MarkerGroup, ...]]] = [("C", ("F", "M", "C")), ("M", ("F", "M"))]
    for group, groups in cases:
        look = SearchPass(0, 0, 640, 480, 2, (group,))
        assert planner.widened(look) == (replace(look, groups=groups),)


def test_what_is_hardly_legible_is_looked_at_enlarged(planner: SearchPlanner) -> None:
    # F has cells of 2.7 px at 12 m and of 4 at 8 m
    plain, enlarged = planner.expected(np.eye(3), np.array([0.0, 0.0, 12.0]), 0.05)
    assert (plain.enlarge, enlarged) == (1, replace(plain, enlarge=2))
    assert [look.enlarge for look in planner.expected(np.eye(3), np.array([0.0, 0.0, 8.0]), 0.05)] == [1]
    # but not most of the frame
    assert [look.enlarge for look in planner.expected(np.eye(3), np.array([0.0, 0.0, 12.0]), 2.5)] == [1]


def test_a_pad_that_is_near_is_looked_for_in_every_frame(planner: SearchPlanner) -> None:
    far = SearchPass(0, 0, 640, 480, 1, GROUPS)
    close = tuple(SearchPass(0, 0, 640, 480, shrink, GROUPS) for shrink in (4, 2))
    assert [planner.whole_frame(turn) for turn in (1, 2)] == [close, (far,)]
    assert [planner.whole_frame(turn, near=True) for turn in (1, 2)] == [close, (*close, far)]
    assert planner.is_near(np.array([0.1, 0.0, 0.1]), 0.05)
    assert not planner.is_near(np.array([0.1, 0.0, 0.1]), 0.4)
    assert not planner.is_near(np.array([0.0, 0.0, 2.0]), 0.1)


def test_beside_markers_that_are_hardly_legible_a_larger_one_in_view_is_looked_for(
    planner: SearchPlanner,
) -> None:
    # at the frame's left edge, one of F is whole; M has cells of 1.9 px at 4.3 m and of 6 at 1.3 m
    cut = planner.expected(np.eye(3), np.array([-2.8, 0.0, 4.3]), 0.02)
    assert cut[0].groups == ("F", "M")
    legible = planner.expected(np.eye(3), np.array([-0.6, 0.0, 1.3]), 0.02)
    assert legible[0].groups == ("M",)


def test_a_pad_of_close_markers_alone_is_looked_for_in_full_as_well(pad: Pad, camera: CameraConfig) -> None:
    close = pad.model_copy(update={"markers": tuple(m for m in pad.markers if m.group == "C")})
    planner = SearchPlanner(close, Lens(camera), VisionConfig())
    looks = [look for turn in (1, 2) for look in planner.whole_frame(turn)]
    assert any(look.shrink == 1 and "C" in look.groups for look in looks)


def test_what_may_be_whole_in_the_frame_is_looked_for_at_its_edge(planner: SearchPlanner) -> None:
    # the nearest far marker's outer corner is expected 10 px outside
    away = np.array([0.0, -1.56, 3.0])
    surely_cut = planner.expected(np.eye(3), away + np.array([0.0, -1.5, 0.0]), 0.02)
    perhaps = planner.expected(np.eye(3), away, 0.1)
    assert surely_cut == ()
    assert perhaps
    assert all(0 <= look.left < look.right <= 640 and 0 <= look.top < look.bottom <= 480 for look in perhaps)
