"""Adam on selected rows compared with torch.optim.Adam."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from fourd.reconstruction.training.points.selective_adam import BETAS, EPSILON, SelectiveAdam


def gradients(count: int, steps: int) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return [torch.randn(count, 3, generator=generator) for _ in range(steps)]


def torch_adam(start: torch.Tensor, given: list[torch.Tensor], rate: float) -> torch.Tensor:
    parameter = torch.nn.Parameter(start.clone())
    optimizer = torch.optim.Adam([parameter], lr=rate, betas=BETAS, eps=EPSILON)
    for gradient in given:
        parameter.grad = gradient
        optimizer.step()
    return parameter.detach()


def test_all_rows_selected_equals_torch_adam() -> None:
    """Catches a wrong bias correction, decay or epsilon in Adam."""
    parameters = {"xyz": torch.rand(50, 3)}
    given = gradients(50, 8)
    expected = torch_adam(parameters["xyz"], given, 0.01)
    optimizer = SelectiveAdam.initial(parameters)
    for gradient in given:
        optimizer.step(parameters, torch.arange(50), {"xyz": gradient}, {"xyz": 0.01})
    torch.testing.assert_close(parameters["xyz"], expected)


def test_each_row_counts_its_own_steps() -> None:
    """Catches a bias correction with the step count of other rows, and unselected rows that old momentum moves."""
    parameters = {"xyz": torch.rand(6, 3)}
    before = parameters["xyz"].clone()
    optimizer = SelectiveAdam.initial(parameters)
    steps = {0: [0, 1, 2, 3], 4: [0, 2], 5: [3]}
    given = gradients(6, 4)
    for step, gradient in enumerate(given):
        rows = torch.tensor([row for row, taken in steps.items() if step in taken])
        optimizer.step(parameters, rows, {"xyz": gradient[rows]}, {"xyz": 0.01})
    for row in range(6):
        taken = [given[step][row : row + 1] for step in steps.get(row, [])]
        torch.testing.assert_close(parameters["xyz"][row : row + 1], torch_adam(before[row : row + 1], taken, 0.01))
    assert optimizer.steps.tolist() == [4, 0, 0, 0, 2, 1]


def test_rates_differ_by_row() -> None:
    """Catches an optimizer that applies the learning rate of one row to all rows."""
    parameters = {"xyz": torch.zeros(2, 3)}
    optimizer = SelectiveAdam.initial(parameters)
    rates = torch.tensor([[0.1], [0.3]])
    optimizer.step(parameters, torch.tensor([0, 1]), {"xyz": torch.ones(2, 3)}, {"xyz": rates})
    torch.testing.assert_close(parameters["xyz"], -rates.expand(2, 3))


def test_kept_rows_keep_their_state_and_new_rows_start_anew() -> None:
    """Catches optimizer state that is assigned to the wrong row when points are removed."""
    parameters = {"xyz": torch.rand(4, 3)}
    optimizer = SelectiveAdam.initial(parameters)
    optimizer.step(parameters, torch.tensor([1, 3]), {"xyz": gradients(2, 1)[0]}, {"xyz": 0.01})
    moments = optimizer.moments["xyz"].clone()
    optimizer.keep_rows(torch.tensor([0, 3]), 2)
    assert torch.equal(optimizer.moments["xyz"][:, :2], moments[:, [0, 3]])
    assert not optimizer.moments["xyz"][:, 2:].any()
    assert optimizer.steps.tolist() == [0, 1, 0, 0]


def test_gradients_that_are_noise_do_not_move_colours(rng: np.random.Generator) -> None:
    """Catches a value of Adam's epsilon that is too small. Tiny gradients of alternating sign would then cause full
    steps and speckled colours.
    """
    parameters = {"rgb": torch.full((2, 3), 0.5)}
    optimizer = SelectiveAdam.initial(parameters)
    for _ in range(300):
        noise = torch.from_numpy(rng.normal(size=3)).float()
        gradient = torch.stack([1e-8 * noise, 1e-5 * (parameters["rgb"][1] - 0.3)])
        optimizer.step(parameters, torch.tensor([0, 1]), {"rgb": gradient}, {"rgb": 0.005})
    assert parameters["rgb"][0].tolist() == pytest.approx([0.5] * 3, abs=0.02)
    assert parameters["rgb"][1].tolist() == pytest.approx([0.3] * 3, abs=0.02)
