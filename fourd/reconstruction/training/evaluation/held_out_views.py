"""The held-out views of a training: which camera it leaves out, until when, and the measurement of their score."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import nearest_views
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.evaluation.held_out import (
    HeldOutScore,
    plan_held_out,
    read_score,
    save_score,
)
from fourd.reconstruction.training.evaluation.render import ModelRenderer
from fourd.reconstruction.training.evaluation.scores import score_view
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.recording.capture import Capture

ROUNDS = 8
"""Maximum number of rounds of a measurement. A round renders one held-out view and one training view of a frame."""
LEAST_ROUNDS = 2
COST = 0.01
"""A measurement starts no further round once it has taken this fraction of the training time."""
NEAR_VIEWS = 4
"""Number of training cameras that are compared with a held-out one: those that are nearest to it, which see about the
same."""
GOLDEN_RATIO = (5**0.5 - 1) / 2
VALIDATION = "validation/psnr"
TRAINING_VALIDATION = "validation/training_psnr"


class TrainableRun(Protocol):
    """The part of :class:`fourd.reconstruction.training.run.Run` that is needed here."""

    @property
    def capture(self) -> Capture:
        """The capture with the selected views and frames."""

    @property
    def training(self) -> list[int]:
        """Indices of the training cameras."""

    @property
    def test(self) -> list[int]:
        """Indices of the test views."""

    @property
    def focus(self) -> NDArray[np.float64]:
        """(3,) centre of the bounds, in world units."""

    @property
    def checkpoints(self) -> Path:
        """Folder of the checkpoints."""


class HeldOutViews:
    """The held-out views of a run: its test views or, in the first part of training, one camera.

    Attributes:
        camera: index of the camera that training leaves out now, or None.
        score: the run's held-out score, or None if it was not measured yet.
    """

    def __init__(self, run: TrainableRun, config: TrainConfig, step: int, *, is_warm: bool = False) -> None:
        """Decide what is left out.

        Args:
            run: the run.
            config: the config of the run.
            step: number of completed steps of the checkpoint from which training continues. A score that was measured
                after this step does not count, because the steps before it are repeated.
            is_warm: whether training starts from networks that were trained on all cameras.
        """
        self._run = run
        self._config = config
        plan = plan_held_out(config.held_out, run.capture.cameras, run.training, run.test, run.focus)
        score = read_score(run.checkpoints)
        self.score = score if score is not None and score.step <= step else None
        reason = plan.reason
        if is_warm and plan.camera is not None:
            reason = "training starts from networks that were trained on all cameras"
        if reason and self.score is None:
            self.score = HeldOutScore(0, reason=reason)
        self.camera = plan.camera if self.score is None else None
        self._until = plan.until

    @property
    def training(self) -> list[int]:
        """Indices of the cameras that training uses now."""
        return [index for index in self._run.training if index != self.camera]

    @property
    def exist(self) -> bool:
        """Whether the run has held-out views, now or in the part of training that is over."""
        return bool(self._run.test) or self.camera is not None or self._was_released

    @property
    def validation(self) -> tuple[list[int], str]:
        """Indices of the cameras with which training validates now, and the name of the measurement in the log. Without
        held-out views, training views are used. They have another name if the log has values of held-out views."""
        if self._run.test or self.camera is not None:
            return self._run.test or [index for index in [self.camera] if index is not None], VALIDATION
        return self._run.training, TRAINING_VALIDATION if self._was_released else VALIDATION

    def save(self) -> None:
        """Write the score, if it is known, to the run."""
        if self.score is not None:
            save_score(self.score, self._run.checkpoints)

    def is_release_due(self, spent: float) -> bool:
        """Return whether the camera that is left out has to be measured now. ``spent`` is the fraction of the budget
        that is spent."""
        return self.camera is not None and spent >= self._until

    def is_test_due(self, step: int) -> bool:
        """Return whether the test views have to be measured after the last step ``step``."""
        return bool(self._run.test) and (self.score is None or self.score.step != step)

    def release(self) -> None:
        """Train on all cameras from now on."""
        self.camera = None

    def measure(
        self, renderer: ModelRenderer, points: Callable[[int], FramePoints], frames: Sequence[int], seconds: float
    ) -> HeldOutScore:
        """Measure the score of held-out views and of the training views near them.

        Args:
            renderer: renders the scene, from the images of the cameras that training uses.
            points: returns the points of a frame.
            frames: indices of the frames that can be rendered.
            seconds: training time until now, which limits the time of the measurement.

        Returns:
            the score, whose step is 0.
        """
        run, started = self._run, time.monotonic()
        held = run.test or [index for index in [self.camera] if index is not None]
        near = {index: self._near(index) for index in held}
        is_box = self._config.scene == "object"
        held_out: dict[tuple[int, int], float] = {}
        training: dict[tuple[int, int], float] = {}
        for number, frame in enumerate(_spread(frames, ROUNDS)):
            camera = held[number % len(held)]
            other = near[camera][number // len(held) % len(near[camera])]
            for index, values in ((camera, held_out), (other, training)):
                if (index, frame) not in values:
                    value = self._psnr(renderer, points(frame), index, frame, is_box=is_box)
                    values.update({} if value is None else {(index, frame): value})
            if number + 1 >= max(LEAST_ROUNDS, min(len(held), ROUNDS)) and time.monotonic() - started > COST * seconds:
                break
        names = tuple(run.capture.names[index] for index in held)
        if not held_out or not training:
            return HeldOutScore(0, names, reason=f"the subject is in no measured image of {', '.join(names)}")
        return HeldOutScore(
            0,
            names,
            "test" if run.test else "left out",
            float(np.mean(list(held_out.values()))),
            float(np.mean(list(training.values()))),
            len(held_out),
            "box" if is_box else "image",
            min(self._angle_deg(index, near[index][0]) for index in held),
        )

    @property
    def _was_released(self) -> bool:
        return self.score is not None and self.score.kind == "left out"

    def _near(self, camera: int) -> list[int]:
        cameras, training = self._run.capture.cameras, self.training
        near = nearest_views(cameras[camera], [cameras[index] for index in training], NEAR_VIEWS, self._run.focus)
        return [training[index] for index in near]

    def _angle_deg(self, first: int, second: int) -> float:
        one, other = (self._run.capture.cameras[index].centre - self._run.focus for index in (first, second))
        return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))

    def _psnr(
        self, renderer: ModelRenderer, points: FramePoints, camera: int, frame: int, *, is_box: bool
    ) -> float | None:
        """Return the PSNR of a rendered view, or None if only the box around the subject counts and the view does not
        show the subject."""
        view = renderer.views.view(camera, frame)
        whole = self._run.capture.cameras[camera]
        if not is_box and view.rgb.shape[:2] != (whole.height, whole.width):
            view = renderer.views.widened(camera, frame, max(whole.width, whole.height) * 2)
        layers = self._config.layers
        rendered = renderer.render(points, frame, view.camera, layers, exclude=camera)
        image, box = score_view(rendered.rgb, renderer.scene.reference_picture(view), view.matte, None)
        if is_box:
            return None if box is None else _finite(box.psnr)
        return _finite(image.psnr)


def _finite(psnr: float) -> float:
    return min(psnr, 100.0)


def _spread(frames: Sequence[int], count: int) -> Iterator[int]:
    """Yield ``count`` frames, spread evenly over ``frames`` however many of them are used."""
    for number in range(count):
        yield frames[int((number + 0.5) * GOLDEN_RATIO % 1.0 * len(frames))]
