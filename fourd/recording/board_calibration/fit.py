"""Fit of a rig to the views of a board: initial values, bundle adjustment, and held-out frames that measure errors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.progress import Track
from fourd.recording.board_calibration.adjustment.noise import ViewNoise
from fourd.recording.board_calibration.adjustment.refine import refine_rig, with_motion
from fourd.recording.board_calibration.adjustment.rig import (
    LENS,
    PARAMETERS,
    POSE,
    TIME,
    BoardShape,
    Corners,
    Poses,
    RigState,
    Timing,
    collect_corners,
    reprojection_errors,
)
from fourd.recording.board_calibration.adjustment.solver import Errors, solve_rig
from fourd.recording.board_calibration.adjustment.system import Free
from fourd.recording.board_calibration.detection import BoardView
from fourd.recording.board_calibration.initial import (
    CameraPair,
    LocatedView,
    chain_poses,
    initial_boards,
    initial_lens,
    join_cameras,
    locate_views,
    pair_cameras,
    views_by_camera,
)
from fourd.recording.boards import CalibrationBoard

Array = NDArray[np.float64]

HELD_OUT_EVERY = 5
"""At most one of this number of frames is held out of the first fit, to measure the errors of this fit."""
MIN_LENS_VIEWS = 5
"""Minimum number of views (images that show the board) from a camera whose lens is estimated."""
MIN_POSE_VIEWS = 3
"""Minimum number of views from a camera whose lens is known."""
MIN_FITTED_VIEWS = 8
"""A frame is held out only if each camera that sees the board in it keeps at least this number of views in the fit."""
MIN_FITTED_PAIRS = 4
"""A frame is held out only if, for each pair of cameras that see the board in it, the fit keeps at least this number of
frames in which both cameras see the board."""
SCALES_PX = (10.0, 1.0, 0.5)
"""Scales, in pixels, of the Huber loss in the successive adjustments."""
MEDIAN_PER_STD = 1.177
"""Median length of a normally distributed two-dimensional vector, in standard deviations."""
CORRELATION = 2.5
"""Factor that multiplies the corners' standard deviation when the corners are weighed against the prior on the lenses.
It accounts for correlated errors of the corners in one image, which are caused by motion blur, a board that is not
exactly flat, and cameras that do not expose at exactly the same time."""
OUTLIER_MEDIANS = 6.0
"""Maximum error of a corner in the last adjustment, as a multiple of its camera's median error. Corners with larger
errors are left out."""
MIN_OUTLIER_PX = 0.3
MAX_MEDIAN = 0.004
"""Maximum median error of a camera, as a fraction of the image's longer side. A larger error means that the cameras do
not see one rigid board at the same time."""
TIMING_GAIN = 0.97
"""The cameras' delays and readout durations are kept if they reduce the mean error on held-out frames to less than this
multiple of the mean error without them."""
OFFSET_STD = (0.0006, 0.0006, 0.002)
"""Standard deviations of the prior on a corner's displacement along the board's x, y and z, in sides of a square."""
MAX_OFFSETS = 60
"""Displacements of corners are adjusted only for boards with at most this number of corners. On boards with more
corners, the displacements average out."""


@dataclass(frozen=True, eq=False)
class RigFit:
    """A fitted rig.

    Attributes:
        cameras: C cameras in the coordinates of the first camera, in metres.
        frames: F frame numbers, in ascending order.
        boards: F poses from board to world.
        held_out: (F,) whether the frame is held out. The rig is fitted first without the held-out frames, and then to
            all frames. ``errors`` comes from the first fit, and the other results come from the second.
        corners: the corners of all frames.
        errors: (N,) reprojection errors of the corners in pixels, with the cameras of the first fit and the best pose
            of the board in each frame.
        std: (C, 17) standard deviations of the cameras' parameters; see
            :mod:`fourd.recording.board_calibration.adjustment.rig`.
        pairs: pairs of cameras that see the board in the same frame.
        estimated: (C,) whether a camera's lens was estimated.
        timing: delays and readouts of the cameras, or None if all rows are assumed to be exposed at the same time.
        thickness_m: distance between the front and the back of a double-sided board.
    """

    cameras: tuple[Camera, ...]
    frames: tuple[int, ...]
    boards: Poses
    held_out: NDArray[np.bool_]
    corners: Corners
    errors: Array
    std: Array
    pairs: tuple[CameraPair, ...]
    estimated: NDArray[np.bool_]
    timing: Timing | None = None
    thickness_m: float = 0.0

    def rms(self, camera: int, held_out: bool) -> float | None:
        """Return the root mean square error, in pixels, of a camera on the held-out frames or on the frames of the
        first fit. The result is None if the camera has no error for the requested frames."""
        rows = (self.corners.camera == camera) & (self.held_out[self.corners.board] == held_out)
        return float(np.sqrt(np.mean(self.errors[rows] ** 2))) if rows.any() else None


@dataclass(frozen=True, eq=False)
class RigInput:
    """The observations of a rig.

    Attributes:
        where: path of the videos, for error messages.
        names: names of the C cameras.
        sizes: width and height of each camera's images.
        lenses: for each camera, a Camera with the known lens and an unused pose, or None if the lens is estimated.
        board: the board.
        views: views of the board.
        turns: angle in degrees, a multiple of 90, by which each camera's images were rotated to be upright.
    """

    where: str
    names: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]
    lenses: tuple[Camera | None, ...]
    board: CalibrationBoard
    views: tuple[BoardView, ...]
    turns: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class _Rough:
    """A rig whose reprojection errors are at most a few pixels.

    Attributes:
        state: the rig.
        corners: corners without gross errors.
        frames: frame number of each position of the board.
        free: (C, 17) mask of the parameters that are adjusted.
        corner_px: (C,) standard deviation, in pixels, of the corners' errors in each camera.
    """

    state: RigState
    corners: Corners
    frames: tuple[int, ...]
    free: NDArray[np.bool_]
    corner_px: Array


def fit_rig(rig: RigInput, track: Track) -> RigFit:
    """Calibrate a rig in the coordinates of its first camera.

    Raises:
        UserError: if a camera has too few views, shared frames do not connect all cameras, or the views contradict
            each other.
    """
    _check_views(rig)
    frames = sorted({view.frame for view in rig.views})
    held_out = choose_held_out(rig.views, frames)
    fitted = [frame for frame in frames if frame not in held_out]
    views = [view for view in rig.views if view.frame not in held_out]
    by_camera = views_by_camera(views, len(rig.names))
    cameras = tuple(
        replace(lens, rotation=np.eye(3), translation=np.zeros(3))
        if lens is not None
        else initial_lens(rig.board, by_camera[index], *rig.sizes[index])
        for index, lens in enumerate(track(rig.lenses, len(rig.lenses), "initial lenses"))
    )
    located = locate_views(rig.board, cameras, rig.views)
    pairs = pair_cameras([each for each in located if each.view.frame not in held_out])
    groups = join_cameras(len(cameras), pairs)
    if len(groups) > 1:
        raise _not_joined(rig, groups)
    poses = chain_poses(len(cameras), pairs)
    cameras = tuple(
        replace(camera, rotation=poses.rotation[index], translation=poses.translation[index])
        for index, camera in enumerate(cameras)
    )
    frames = [frame for frame in frames if any(each.view.frame == frame for each in located)]
    rough = _adjust(rig, cameras, located, [frame for frame in fitted if frame in frames], track)
    tested = _choose_timing(rig, rough, located, frames, held_out, track)
    return _fit_all(rig, rough, tested, located, frames, held_out, tuple(pairs))


def choose_held_out(views: Sequence[BoardView], frames: Sequence[int]) -> set[int]:
    """Choose the held-out frames: every fifth frame, except frames that the fit needs for a camera or a pair of
    cameras."""
    seen: dict[int, list[int]] = {frame: [] for frame in frames}
    for view in views:
        seen[view.frame].append(view.camera)
    count = Counter(camera for cameras in seen.values() for camera in cameras)
    pairs = Counter(pair for cameras in seen.values() for pair in combinations(sorted(cameras), 2))
    chosen = set()
    for frame in frames[HELD_OUT_EVERY // 2 :: HELD_OUT_EVERY]:
        cameras = seen[frame]
        shared = list(combinations(sorted(cameras), 2))
        if any(count[camera] <= MIN_FITTED_VIEWS for camera in cameras) or any(
            pairs[pair] <= MIN_FITTED_PAIRS for pair in shared
        ):
            continue
        chosen.add(frame)
        count.subtract(cameras)
        pairs.subtract(shared)
    return chosen


def _check_views(rig: RigInput) -> None:
    """Raise UserError if a camera has too few views."""
    count = Counter(view.camera for view in rig.views)
    if len(count) == 1 and len(rig.names) > 1:
        name = rig.names[next(iter(count))]
        raise UserError(
            f"{rig.where}: expected two cameras that see the board, got only {name}; hold the board where several "
            "cameras see it, or correct the board's file"
        )
    for index, name in enumerate(rig.names):
        needed = MIN_LENS_VIEWS if rig.lenses[index] is None else MIN_POSE_VIEWS
        if count[index] < needed:
            raise UserError(
                f"{rig.where}: {name}: expected the board in at least {needed} frames, got {count[index]}; film the "
                "board longer in front of this camera, or remove its video"
            )


def _not_joined(rig: RigInput, groups: Sequence[Sequence[int]]) -> UserError:
    texts = [" and ".join(rig.names[index] for index in group) for group in groups]
    return UserError(
        f"{rig.where}: expected cameras that are joined by frames in which two of them see the board, got separate "
        f"groups: {'; '.join(texts)}; film the board where cameras of two groups see it at the same time"
    )


def _adjust(
    rig: RigInput, cameras: tuple[Camera, ...], located: Sequence[LocatedView], frames: Sequence[int], track: Track
) -> _Rough:
    """Adjust the poses, and then poses and lenses together. The errors of the corners are treated as independent."""
    corners = collect_corners(rig.board, [each.view for each in located], frames)
    state = RigState(cameras, initial_boards(rig.board, cameras, located, frames))
    free = np.zeros((len(cameras), PARAMETERS), bool)
    free[1:, POSE] = True
    lens = free.copy()
    lens[[each is None for each in rig.lenses], LENS] = True
    stages = [(free, SCALES_PX[0]), *((lens, scale) for scale in SCALES_PX)]
    corner_px = np.ones(len(cameras))
    inliers = np.ones(len(corners.camera), bool)
    for number, (mask, scale) in enumerate(track(stages, len(stages), "bundle adjustment")):
        errors = Errors(ViewNoise(corner_px), np.full(len(cameras), scale))
        state = solve_rig(state, corners.select(inliers), Free(mask), errors)
        found = reprojection_errors(state, corners)
        medians = np.array([np.median(found[corners.camera == index]) for index in range(len(cameras))])
        if number > 0:
            corner_px = CORRELATION * np.minimum(medians / MEDIAN_PER_STD, 1.0)
        if number == len(stages) - 2:
            _check_agreement(rig, medians)
            inliers = found <= np.maximum(OUTLIER_MEDIANS * medians, MIN_OUTLIER_PX)[corners.camera]
    return _Rough(state, corners.select(inliers), tuple(frames), lens, corner_px / CORRELATION)


def _check_agreement(rig: RigInput, medians: Array) -> None:
    """Raise UserError if the median error of a camera is too large for one rigid board. ``medians`` (C,) are the
    cameras' median errors in pixels."""
    limits = [MAX_MEDIAN * max(size) for size in rig.sizes]
    worst = int(np.argmax(medians / limits))
    if medians[worst] > limits[worst]:
        raise UserError(
            f"{rig.where}: {rig.names[worst]}: expected one rigid board of {1e3 * rig.board.square_m:g} mm squares in "
            f"all cameras, got a median error of {medians[worst]:.1f} px; check that all boards have squares of "
            "the same size, that the videos are synchronised (--offset), and that no camera was moved"
        )


def _choose_timing(
    rig: RigInput,
    rough: _Rough,
    located: Sequence[LocatedView],
    frames: Sequence[int],
    held_out: set[int],
    track: Track,
) -> RigState:
    """Adjust the rig twice: without and with delays and readouts. Delays and readouts are kept only if they clearly
    reduce the error on held-out frames.

    Returns the adjusted rig with the positions of the board in all frames.
    """
    best: tuple[float, RigState] | None = None
    corners = collect_corners(rig.board, [each.view for each in located], frames)
    tested = np.array([frame in held_out for frame in frames], bool)[corners.board]
    for timed in track((False, True), 2, "timing"):
        if timed and not tested.any():
            continue
        state = refine_rig(*_start(rig, rough, timed), rough.corner_px).state
        state = replace(state, boards=locate_boards(rig.board, state, located, frames, rough.frames))
        errors = reprojection_errors(with_motion(state, frames), corners)
        score = float(errors[tested].mean()) if tested.any() else 0.0
        if best is None or score < TIMING_GAIN * best[0]:
            best = (score, state)
    assert best is not None
    return best[1]


def _start(rig: RigInput, rough: _Rough, timed: bool) -> tuple[RigState, Corners, tuple[int, ...], Free]:
    """Return the initial rig, corners, frame numbers and free parameters for :func:`refine_rig`."""
    count, corners = len(rig.names), rough.corners
    mask, timing = rough.free.copy(), None
    if timed:
        mask[:, TIME] = True
        # Delays are relative to the first camera, so its delay is fixed at 0.
        mask[0, TIME.start] = False
        phase = [
            (0.0, 1 / h) if turn % 180 == 0 else (1 / w, 0.0)
            for turn, (w, h) in zip(rig.turns or (0,) * count, rig.sizes, strict=True)
        ]
        timing = Timing(np.zeros(count), np.zeros(count), np.array(phase), np.zeros((len(rough.frames), 6)))
    points = len(rig.board.corners)
    few = points <= MAX_OFFSETS
    offsets = np.tile(np.array(OFFSET_STD) * rig.board.square_m, (points, 1)) if few else np.zeros((0, 3))
    free = Free(mask, offsets, bool(corners.back.any() and not corners.back.all()))
    state = replace(rough.state, timing=timing, shape=BoardShape(np.zeros((points, 3)), 0.0))
    return state, corners, rough.frames, free


def _fit_all(
    rig: RigInput,
    rough: _Rough,
    tested: RigState,
    located: Sequence[LocatedView],
    frames: Sequence[int],
    held_out: set[int],
    pairs: tuple[CameraPair, ...],
) -> RigFit:
    """Adjust the rig to all frames. The reported errors are those of the rig that was fitted without the held-out
    frames."""
    corners = collect_corners(rig.board, [each.view for each in located], frames)
    errors = reprojection_errors(with_motion(tested, frames), corners)
    medians = np.array([np.median(errors[corners.camera == index]) for index in range(len(rig.names))])
    inliers = errors <= np.maximum(OUTLIER_MEDIANS * medians, MIN_OUTLIER_PX)[corners.camera]
    _, _, _, free = _start(rig, rough, tested.timing is not None)
    solution = refine_rig(tested, corners.select(inliers), frames, free, rough.corner_px)
    state = solution.state
    return RigFit(
        state.cameras,
        tuple(frames),
        locate_boards(rig.board, state, located, frames, frames),
        np.array([frame in held_out for frame in frames]),
        corners,
        errors,
        solution.std,
        pairs,
        np.array([lens is None for lens in rig.lenses]),
        state.timing,
        state.shape.thickness_m if state.shape is not None else 0.0,
    )


def locate_boards(
    board: CalibrationBoard,
    rig: RigState,
    located: Sequence[LocatedView],
    frames: Sequence[int],
    known: Sequence[int] = (),
) -> Poses:
    """Fit the poses of the board in ``frames`` to the views of all cameras, with the cameras fixed.

    Args:
        board: the board.
        rig: the cameras, their timing, the shape of the board, and its initial poses in the frames ``known``.
        located: the views, each with the poses of the board that fit its corners.
        frames: frame numbers, in ascending order.
        known: frame numbers of the poses in ``rig``.
    """
    count = len(rig.cameras)
    unknown = [frame for frame in frames if frame not in known]
    start = initial_boards(board, rig.cameras, located, unknown)
    numbers = [known.index(frame) if frame in known else len(known) + unknown.index(frame) for frame in frames]
    rotation = np.concatenate([rig.boards.rotation[: len(known)], start.rotation])[numbers]
    translation = np.concatenate([rig.boards.translation[: len(known)], start.translation])[numbers]
    state = replace(rig, boards=Poses(rotation, translation))
    corners = collect_corners(board, [each.view for each in located], frames)
    fixed = Free(np.zeros((count, PARAMETERS), bool))
    for scale in SCALES_PX:
        errors = Errors(ViewNoise(np.ones(count)), np.full(count, scale))
        state = solve_rig(with_motion(state, frames), corners, fixed, errors)
    return state.boards
