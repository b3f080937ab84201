"""The table of what each factor costs: its scores, its rows, and the captures on which it trains."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fourd.recording.capture import open_capture
from fourd.recording.synth import make_synthetic
from fourd.recording.synth.rig import FACTORS
from tests.captures import write_ball_capture
from tools.measurements.quality.rig_table import (
    Arguments,
    Result,
    box_scores,
    main,
    markdown,
    record,
    relative_flicker,
    rows,
    source_options,
)


def test_scores_are_those_of_the_box_and_a_fitted_gain_costs_nothing() -> None:
    """Catches scores of the black surroundings, and a constant of the colour map that makes them grey."""
    rng = np.random.default_rng(0)
    matte = np.zeros((64, 64), np.uint8)
    matte[20:40, 24:44] = 255
    share = matte[..., None] / np.float32(255)
    truths = [(rng.uniform(0.2, 0.8, (64, 64, 3)) * share).astype(np.float32) for _ in range(2)]
    noisy = [truth + share * rng.normal(0, 0.02, truth.shape).astype(np.float32) for truth in truths]
    other = [np.concatenate([0.8 * image + 0.1 * share, share], axis=2) for image in noisy]
    scores = np.array(box_scores(other, truths, [matte, matte]))
    # The box is 36 pixels wide with its margin of 8 pixels, of which 20 x 20 pixels are subject.
    assert scores[:, 1] == pytest.approx([-20 * np.log10(0.02 * 20 / 36)] * 2, abs=0.3)
    assert (scores[:, 0] < scores[:, 1] - 5).all()
    assert relative_flicker(truths, truths) == 0
    assert relative_flicker([truths[0]] * 2, truths) == pytest.approx(1)


def test_losses_are_differences_from_the_clean_run() -> None:
    """Catches losses of the wrong sign."""
    text = markdown({"clean": Result(30.0, 30.5, 0.3), "noise": Result(28.5, 29.5, 0.45)})
    assert text.splitlines()[2:] == [
        "| clean | 30.00 | - | 30.50 | - | 0.300 | - |",
        "| noise | 28.50 | 1.50 | 29.50 | 1.00 | 0.450 | 0.150 |",
    ]


def test_each_row_trains_on_its_own_capture(tmp_path: Path) -> None:
    """Catches a row of automatic mattes that gets true ones, and a single factor that gets none."""
    assert list(rows("all")) == ["clean", "mattes", *FACTORS, "together, true mattes", "together"]
    clean = write_ball_capture(tmp_path / "ball", cameras=3, frames=2, size=32)
    for name, has_mattes in (("clean", True), ("mattes", False), ("blur", True)):
        record(clean, tmp_path / name, rows("all")[name], 0)
        with open_capture(tmp_path / name) as capture:
            assert capture.has_masks == has_mattes
            assert capture.frame_count == 2
    assert source_options(clean, 3) == ["--from", clean, "--seed", 3]
    make_synthetic(tmp_path / "figure", frames=1, cameras=3, size=32, seed=5)
    assert source_options(tmp_path / "figure", 3)[:8] == ["--frames", 1, "--cameras", 3, "--size", 32, "--seed", 5]


def test_wrong_names_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a row that is not measured without a word, and runs without held-out views."""
    clean = write_ball_capture(tmp_path / "ball", cameras=3, frames=1, size=32)
    assert main(Arguments([clean], tmp_path / "out", only=["nois"])) == 2
    assert "--only: expected rows among clean, mattes, exposure" in capsys.readouterr().err
    assert main(Arguments([clean], tmp_path / "out", only=["clean"])) == 2
    assert "expected held-out views, got none; name some with --test-views" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
