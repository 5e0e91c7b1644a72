"""The acceptance test of a camera calibration: good enough to fly with, or why not. Pure."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calibration.camera import Model
from calibration.camera.board import Surface
from calibration.camera.solver import (
    CameraSolution,
    Intrinsics,
    Uncertainty,
    UnsolvableError,
    held_out_rms_px,
    projection_std_px,
    rms,
    rms_of_all,
    solve,
    uncertainty,
)
from calibration.camera.views import CORNERS, BoardView, ImageCoverage, distance_px
from companion.base.geometry import FloatArray
from companion.sense.vision.lens import fisheye_radius, radial_factor

FEWEST_VIEWS: Final = 8
SMALLEST_COVERAGE: Final = 0.55
MOST_CORNERS_MISSING: Final = 2
SMALLEST_TILT_DEG: Final = 15.0
# of the focal length, and of the image's width
LARGEST_FOCAL_STD: Final = 0.003
LARGEST_CENTRE_STD: Final = 0.003
# of the image's width; a pixel and a quarter at 1280
LARGEST_PROJECTION_STD: Final = 0.004
LARGEST_RMS: Final = 0.0012
SMALLEST_LIMIT_PX: Final = 1.0
# of the views; with more, the rest may be the wrong ones
MOST_DROPPED: Final = 0.3
OVERFIT_RATIO: Final = 1.5
FOLD_SAMPLES: Final = 60


@dataclass(frozen=True, slots=True)
class Assessment:
    """A calibration with its quality figures and the reasons to refuse it."""

    solution: CameraSolution
    coverage: ImageCoverage
    uncertainty: Uncertainty
    projection_std_px: FloatArray
    rms_px: float
    rms_all_px: float
    held_out_rms_px: float | None
    brown_held_out_rms_px: float | None  # of the five-number model, when another was asked for
    reasons: tuple[str, ...]


def assess(
    views: Sequence[BoardView], size_px: tuple[int, int], board: Surface, model: Model = "brown"
) -> Assessment:
    """Calibrate and judge.

    Raises:
        UnsolvableError: there is nothing to judge.
    """
    solution = solve(views, size_px, board, model)
    known = uncertainty(solution)
    coverage = ImageCoverage(size_px)
    for seen in solution.seen:
        coverage.add(seen.view, seen.turn)
    brown = None if model == "brown" else _held_out_of_brown(views, size_px, board)
    found = Assessment(
        solution=solution,
        coverage=coverage,
        uncertainty=known,
        projection_std_px=projection_std_px(solution.camera, known.covariance),
        rms_px=rms(solution.errors_px),
        rms_all_px=rms_of_all(solution, views),
        held_out_rms_px=held_out_rms_px(solution),
        brown_held_out_rms_px=brown,
        reasons=(),
    )
    judges = (_views, _seen, _sure, _fits, _unfolded)
    return replace(found, reasons=tuple(text for judge in judges for text in judge(found)))


def _held_out_of_brown(views: Sequence[BoardView], size_px: tuple[int, int], board: Surface) -> float | None:
    try:
        return held_out_rms_px(solve(views, size_px, board, "brown"))
    except UnsolvableError:
        return None


# ---------------------------------------------------------------- judges: each gives its reasons


def _views(found: Assessment) -> Iterator[str]:
    count, dropped = len(found.solution.seen), len(found.solution.dropped_views)
    different = _different(found)
    if different < FEWEST_VIEWS:
        alike = f" ({count - different} more are of the same)" if different < count else ""
        yield f"too few views: {different}{alike}, expected {FEWEST_VIEWS} or more"
    if dropped > MOST_DROPPED * (count + dropped):
        yield (
            f"{dropped} of {count + dropped} views do not fit the others; expected one board, flat and rigid"
        )


def _different(found: Assessment) -> int:
    """How many of the views show the board elsewhere than the others, by more than the fit may miss.

    Frames of one recording, and files that were copied, err alike and say the same again.
    """
    different: list[BoardView] = []
    for view in (seen.view for seen in found.solution.seen):
        distances = [distance_px(view, other) for other in different]
        if all(distance is None or distance > _most_rms_px(found) for distance in distances):
            different.append(view)
    return len(different)


def _most_rms_px(found: Assessment) -> float:
    return max(SMALLEST_LIMIT_PX, LARGEST_RMS * found.solution.camera.size_px[0])


def _seen(found: Assessment) -> Iterator[str]:
    coverage = found.coverage
    if coverage.share < SMALLEST_COVERAGE:
        yield (
            f"the board was seen in {100 * coverage.share:.0f} % of the image; "
            f"expected {100 * SMALLEST_COVERAGE:.0f} % or more"
        )
    missing = coverage.unseen_corners
    if len(missing) > MOST_CORNERS_MISSING:
        yield (
            f"corners of the image without the board: {', '.join(missing)}; "
            f"expected it in {len(CORNERS) - MOST_CORNERS_MISSING} or more"
        )
    if coverage.largest_tilt_deg < SMALLEST_TILT_DEG:
        yield (
            f"the board was tilted by {coverage.largest_tilt_deg:.0f}° at most; "
            f"expected {SMALLEST_TILT_DEG:.0f}° or more; without tilt the focal length is not observable"
        )


def _sure(found: Assessment) -> Iterator[str]:
    camera, std = found.solution.camera, found.uncertainty.std
    width = camera.size_px[0]
    for name, value, deviation in zip(("fx", "fy"), camera.numbers[:2], std[:2], strict=True):
        if deviation > LARGEST_FOCAL_STD * value:
            yield (
                f"{name} {value:.1f} px is uncertain by {deviation:.1f} px; "
                f"expected {LARGEST_FOCAL_STD * value:.1f} or less"
            )
    for name, deviation in zip(("cx", "cy"), std[2:4], strict=True):
        if deviation > LARGEST_CENTRE_STD * width:
            yield (
                f"{name} is uncertain by {deviation:.1f} px; "
                f"expected {LARGEST_CENTRE_STD * width:.1f} or less"
            )
    worst, place = float(found.projection_std_px.max()), _place(found.projection_std_px)
    if worst > LARGEST_PROJECTION_STD * width:
        yield (
            f"the projection at the {place} of the image is uncertain by {worst:.1f} px; "
            f"expected {LARGEST_PROJECTION_STD * width:.1f} or less"
        )


def _fits(found: Assessment) -> Iterator[str]:
    limit = _most_rms_px(found)
    if found.rms_px > limit:
        yield (
            f"the reprojection error is {found.rms_px:.2f} px; expected {limit:.2f} or less "
            "(board not flat or not as described, images blurred or scaled?)"
        )
    held_out = found.held_out_rms_px
    if held_out is not None and held_out > max(OVERFIT_RATIO * found.rms_px, found.rms_px + 0.02):
        yield (
            f"views that were held out are {held_out:.3f} px off, the others {found.rms_px:.3f}: "
            "the model overfits; expected more views"
        )
    brown = found.brown_held_out_rms_px
    if brown is not None and (held_out is None or held_out >= brown):
        left_out = "no figure" if held_out is None else f"{held_out:.3f} px"
        yield (
            f"the {found.solution.camera.model} model overfits: {left_out} on views held out, "
            f"{brown:.3f} px with five numbers; expected --model brown"
        )


def _unfolded(found: Assessment) -> Iterator[str]:
    share = unfolded_share(found.solution.camera)
    if share < 1.0:
        yield (
            f"the distortion folds back at {100 * share:.0f} % of the way to the image's corners; "
            "expected the board nearer to them, or the other --model"
        )


def unfolded_share(camera: Intrinsics) -> float:
    """How far from the middle towards its corners (1: all the way) the image grows with the angle."""
    fx, fy, cx, cy = camera.numbers[:4].tolist()
    width, height = camera.size_px
    farthest = max(np.hypot((u - cx) / fx, (v - cy) / fy) for u in (0, width) for v in (0, height))
    if camera.model == "fisheye":
        # what lies beyond is seen by no lens, however black the image's corners are
        r = np.linspace(0.0, np.pi / 2, 3 * FOLD_SAMPLES + 1)
        distorted = fisheye_radius(camera.distortion.tolist(), r)
        return 1.0 if (np.diff(distorted) > 0.0).all() else float(distorted.max() / farthest)
    r = np.linspace(0.0, 3.0 * farthest, 3 * FOLD_SAMPLES + 1)
    distorted = r * radial_factor(camera.distortion.tolist(), r * r)
    falls = np.flatnonzero(np.diff(distorted) <= 0.0)
    top = float(distorted[falls[0]]) if len(falls) else float(distorted[-1])
    return min(1.0, top / float(farthest))


def _place(grid: FloatArray) -> str:
    """Where on a mesh over the image its largest value is, in words."""
    rows, columns = grid.shape
    row, column = np.unravel_index(int(np.argmax(grid)), grid.shape)
    down, right = row / (rows - 1), column / (columns - 1)
    words = [word for word, there in (("upper", down < 0.34), ("lower", down > 0.66)) if there]
    words += [word for word, there in (("left", right < 0.34), ("right", right > 0.66)) if there]
    return " ".join(words) or "middle"
