"""The optimizer's parameters are grouped by the kind of their module."""

from __future__ import annotations

from torch import nn

from fourd.reconstruction.model.config import PlanesConfig
from fourd.reconstruction.model.kplanes import KPlanes
from fourd.reconstruction.training.step import parameters_by_kind


class Named(nn.Module):
    """A model whose names say the opposite of what its modules are."""

    def __init__(self) -> None:
        super().__init__()
        self.planes_head = nn.Linear(2, 3)
        self.grid = KPlanes(PlanesConfig(levels=1), (1.0, 1.0, 1.0), 2)


def test_planes_are_found_by_their_module_not_by_their_name() -> None:
    """Catches a layer that trains at the rate of the planes because its name has "planes" in it, and planes that do not
    because theirs has not."""
    models = (Named(), Named())
    planes, others = parameters_by_kind(models)
    assert [id(each) for each in planes] == [id(each) for model in models for each in model.grid.parameters()]
    assert [id(each) for each in others] == [id(each) for model in models for each in model.planes_head.parameters()]
