"""Train a scene from Python with several values of one setting, and compare the views that training did not use.

    python examples/train_with_settings.py CAPTURE --out runs --points 4000 16000 --max-steps 200

The capture must have masks, or mattes of `fourd matte`. One run is trained for each number of points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import tyro

import fourd
from fourd.reconstruction.training.evaluation.held_out import read_score
from fourd.reconstruction.training.run_layout import CHECKPOINTS


@dataclass(frozen=True)
class Arguments:
    """The capture, the folder of the runs, and what is compared."""

    capture: tyro.conf.Positional[Path]
    """Folder of the capture."""
    out: Path
    """Folder in which the runs are written."""
    points: tuple[int, ...] = (4000, 16000)
    """Numbers of initial points per frame."""
    max_steps: int = 200
    """Number of training steps of each run."""


def main(arguments: Arguments) -> None:
    """Train the runs and print a line for each."""
    config = fourd.TrainConfig(max_steps=arguments.max_steps)
    for points in arguments.points:
        run = fourd.train(arguments.capture, arguments.out / str(points), replace(config, points=points), quiet=True)
        score = read_score(run.folder / CHECKPOINTS)
        held_out = (
            "nothing was held out" if score is None else f"{score.psnr:.1f} dB in views that training did not use"
        )
        print(f"{points} points: {held_out}; {run.folder}")


if __name__ == "__main__":
    main(tyro.cli(Arguments))
