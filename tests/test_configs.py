"""Config files in YAML, which change fields of typed dataclasses."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from fourd.base.configs import load_overlay, save_config, to_yaml
from fourd.base.errors import UserError
from fourd.reconstruction.training.config import TrainConfig


def overlay(tmp_path: Path, text: str) -> TrainConfig:
    path = tmp_path / "my.yaml"
    path.write_text(text)
    return load_overlay(TrainConfig(), path)


def test_round_trip(tmp_path: Path) -> None:
    """Catches a config field that is written in a form that the reader interprets as another value."""
    config = TrainConfig(test_views=("03", "1e3"), frames="1:24", max_seconds=5.0, views=("05",))
    save_config(config, tmp_path / "a.yaml")
    assert load_overlay(TrainConfig(), tmp_path / "a.yaml") == config
    assert "test_views" in to_yaml(config)


def test_yaml_1_1_surprises(tmp_path: Path) -> None:
    """Catches a YAML reader that reads 05 as a number, 1:24 as 84, or 1e-3 as text."""
    config = overlay(tmp_path, "test_views: [05, 1e3]\nframes: 1:24\nrates: {planes: 1e-3}\n")
    assert config.test_views == ("05", "1e3")
    assert config.frames == "1:24"
    assert config.rates.planes == 1e-3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("background: {shadow: true}\nmodel: {appearance: sh}", r"my\.yaml.*shadow: expected.*got sh"),
        ("model: {neighbors: 3}", r"my\.yaml.*neighbors.*neighbours"),
        ("points: many", r"my\.yaml.*points.*many"),
        ("test_views: [05, no]", r"my\.yaml.*test_views.*'no'; put the text in quotes"),
        ("points: 1.5", r"my\.yaml.*points"),
        ("model: 3", r"my\.yaml.*model"),
        ("model: {sh: wavelets}", r"my\.yaml.*sh.*wavelets"),
        ("model: {radius_start: 90}", r"my\.yaml.*radius_range"),
        ("points: 3\npoints: 4", r"my\.yaml.*points"),
        ("[1, 2]", r"my\.yaml"),
        ("a: [", r"my\.yaml"),
        ("points: !!python/object/apply:os.system ['true']", r"my\.yaml"),
    ],
)
def test_mistakes_are_named(text: str, message: str, tmp_path: Path) -> None:
    """Catches an invalid setting that is ignored, converted to another type, or executed as code."""
    with pytest.raises(UserError, match=message) as caught:
        overlay(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"none\.yaml"):
        load_overlay(TrainConfig(), tmp_path / "none.yaml")


def test_hostile_files_are_refused_at_once(tmp_path: Path) -> None:
    """Catches a config reader that blocks on a named pipe, and an error message that expands nested aliases."""
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(UserError, match=r"pipe.yaml: expected a file, got a named pipe; name a file"):
        load_overlay(TrainConfig(), tmp_path / "pipe.yaml")
    nested = tmp_path / "nested.yaml"
    nested.write_text("scene: " + "[&l0 [1], " + ", ".join(_level(index) for index in range(1, 10)) + "]\n")
    with pytest.raises(UserError, match=r"nested.yaml, line 1: scene: expected one of object, full, got a list"):
        load_overlay(TrainConfig(), nested)


def _level(index: int) -> str:
    return f"&l{index} [{', '.join([f'*l{index - 1}'] * 10)}]"
