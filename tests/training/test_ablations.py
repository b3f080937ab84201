"""Every example in configs/ is an ablation that can be trained, rendered and exported."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from fourd.base.configs import load_overlay
from fourd.base.errors import UserError
from fourd.reconstruction.training.run import load_run
from fourd.scene.bake import bake_run
from tests.training.small import SMALL, quiet, trained_run, with_steps

CONFIGS = Path(__file__).parents[2] / "configs"
NAMES = sorted(path.stem for path in CONFIGS.glob("*.yaml"))


@pytest.mark.parametrize("name", [name for name in NAMES if name != "paper"])
def test_every_switch_trains_and_is_exported(name: str, ball_capture: Path, tmp_path: Path) -> None:
    """Catches an ablation that crashes, or that is exported although it cannot be baked."""
    config = load_overlay(with_steps(SMALL, 3), CONFIGS / f"{name}.yaml")
    assert config != with_steps(SMALL, 3), "an example without effect"
    run = trained_run(ball_capture, tmp_path / "run", config)
    trained = load_run(run.folder)
    camera = run.capture.cameras[3]
    picture = trained.renderer.render(trained.frames.get(1), 1, camera, 8)
    assert picture.alpha.max() > 0.5
    if name == "continuous":
        with pytest.raises(UserError, match=r"continuous: true; train with model.continuous: false"):
            bake_run(trained, tmp_path / "scene.4dv", quiet())
    else:
        bake_run(trained, tmp_path / "scene.4dv", quiet())


def parameters(name: str, ball_capture: Path, tmp_path: Path) -> set[str]:
    config = load_overlay(with_steps(SMALL, 1), CONFIGS / f"{name}.yaml")
    run = trained_run(ball_capture, tmp_path / name, config)
    state = load_run(run.folder)
    assert all(torch.isfinite(value).all() for value in state.model.state_dict().values())
    return {key.split(".")[0] for key in state.model.state_dict()} | set(state.frames.get(0).parameters)


def test_switches_remove_their_part_of_the_model(ball_capture: Path, tmp_path: Path) -> None:
    """Catches an ablation config that does not remove the corresponding part of the model."""
    both = {"blend_head", "image_encoder", "harmonics_head"}
    assert not {"blend_head", "image_encoder"} & parameters("sh_mlp_only", ball_capture, tmp_path)
    assert "harmonics_head" not in parameters("ibr_only", ball_capture, tmp_path)
    explicit = parameters("sh_explicit", ball_capture, tmp_path)
    assert "harmonics_head" not in explicit
    assert "sh" in explicit
    assert both <= parameters("no_mask_loss", ball_capture, tmp_path)


def test_the_configuration_page_is_up_to_date() -> None:
    """Catches a config key or default that is changed but not documented."""
    from tools.site.configuration_page import PAGE, page

    assert PAGE.read_text() == page(), "run tools/site/configuration_page.py"
