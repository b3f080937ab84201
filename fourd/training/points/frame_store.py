"""Each frame's own points and their optimiser state, in a bounded cache over files."""

from __future__ import annotations

import shutil
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from fourd.files import atomic_path
from fourd.training.memory import in_own_pages

BETAS = (0.9, 0.99)
EPSILON = {"rgb": 1e-6}
"""Of Adam, where it is not DEFAULT_EPSILON. Most points' own colours have next to no say, and would walk at random."""
DEFAULT_EPSILON = 1e-15
HISTORY = ("error", "shown", "born", "lasting", "age", "first")


@dataclass
class FramePoints:
    """What belongs to one frame, or to the background; N points, all float32.

    Attributes:
        xyz: (N, 3) world units.
        spacing: (N,) distance to neighbouring points in world units: radii scale with it.
        radius: (N,) world units, as last evaluated; tells what hides what.
        density: (N,) in (0, 1), likewise.
        free: name -> the optimised tensors: "xyz", when explicit "sh" (N, 48), and of the background "rgb" (N, 3).
        moments: name -> (2, N, C) Adam moments of the tensor of that name.
        steps: (N,) Adam steps that each point has had.
        error, shown: (N,) sum of how hard a point pulled, and in how many steps it showed.
        born: (N,) the age at which it came.
        lasting: (N,) bool, points that stay though they never show.
        age: () steps that the cloud has had.
        first: () how many points it began with.
    """

    spacing: Tensor
    radius: Tensor
    density: Tensor
    free: dict[str, Tensor]
    moments: dict[str, Tensor]
    steps: Tensor
    error: Tensor
    shown: Tensor
    born: Tensor
    lasting: Tensor
    age: Tensor
    first: Tensor

    @property
    def xyz(self) -> Tensor:
        return self.free["xyz"]

    @classmethod
    def fresh(
        cls, xyz: Tensor, spacing: Tensor, start: float, *, explicit_sh: bool, rgb: Tensor | None = None
    ) -> FramePoints:
        """Points not yet trained, of radius ``start`` in their spacings (N,); ``rgb`` (N, 3) of the background."""
        count = xyz.shape[0]
        free = {"xyz": xyz.clone()}
        if explicit_sh:
            free["sh"] = torch.zeros(count, 48)
        if rgb is not None:
            free["rgb"] = rgb.clone()
        return cls(
            spacing=spacing.clone(),
            radius=start * spacing,
            density=torch.full((count,), 0.99),
            free=free,
            moments={name: torch.zeros(2, *value.shape) for name, value in free.items()},
            steps=torch.zeros(count),
            **_no_history(count),
        )

    def take(self, kept: Tensor, parents: Tensor | None = None, partners: Tensor | None = None) -> None:
        """Keep points (K,) alone, and add new ones between ``parents`` (P,) and ``partners`` (P,) of them, in place.

        New points are after the others, of the parents' spacing, radius and density and the means of the rest.
        """
        new = kept[:0] if parents is None else parents
        other = new if partners is None else partners
        empty = torch.zeros(len(new))
        for name, value in self.free.items():
            self.free[name] = _in_own_pages(torch.cat([value[kept], (value[new] + value[other]) / 2]))
            moments = self.moments[name]
            self.moments[name] = _in_own_pages(torch.cat([moments[:, kept], torch.zeros_like(moments[:, new])], dim=1))
        for name in ("spacing", "radius", "density"):
            value = getattr(self, name)
            setattr(self, name, _in_own_pages(torch.cat([value[kept], value[new]])))
        for name in ("steps", "error", "shown"):
            setattr(self, name, _in_own_pages(torch.cat([getattr(self, name)[kept], empty])))
        self.born = torch.cat([self.born[kept], empty + self.age])
        self.lasting = torch.cat([self.lasting[kept], self.lasting[new]])

    def update(self, rows: Tensor, gradients: dict[str, Tensor], rates: dict[str, float | Tensor]) -> None:
        """Adam on ``rows`` (M,) alone (Kingma and Ba 2015): points out of sight keep their state.

        ``gradients`` maps names to (M, C); ``rates`` to learning rates in the tensor's units, one or (M, 1).
        """
        self.steps[rows] += 1
        steps = self.steps[rows][:, None]
        for name, gradient in gradients.items():
            moments = self.moments[name]
            first = moments[0, rows].lerp(gradient, 1 - BETAS[0])
            second = moments[1, rows].lerp(gradient.square(), 1 - BETAS[1])
            moments[0, rows], moments[1, rows] = first, second
            scale = (second / (1 - BETAS[1] ** steps)).sqrt() + EPSILON.get(name, DEFAULT_EPSILON)
            self.free[name][rows] -= rates[name] * first / (1 - BETAS[0] ** steps) / scale

    def tensors(self) -> dict[str, Tensor]:
        """Everything under flat names, for a file."""
        named = {name: getattr(self, name) for name in ("spacing", "radius", "density", "steps", *HISTORY)}
        named.update({f"free.{name}": value for name, value in self.free.items()})
        named.update({f"moments.{name}": value for name, value in self.moments.items()})
        return named

    @classmethod
    def from_tensors(cls, named: dict[str, Tensor]) -> FramePoints:
        """The inverse of :meth:`tensors`."""
        history = _no_history(named["steps"].shape[0])  # files of before points had one
        history.update({name: named[name] for name in HISTORY if name in named})
        return cls(
            spacing=named["spacing"],
            radius=named["radius"],
            density=named["density"],
            free=_below("free.", named),
            moments=_below("moments.", named),
            steps=named["steps"],
            **history,
        )

    def in_own_pages(self) -> FramePoints:
        """A copy outside the heap, to be kept for long."""
        return self.from_tensors({name: _in_own_pages(value) for name, value in self.tensors().items()})

    @property
    def nbytes(self) -> int:
        return sum(value.numel() * value.element_size() for value in self.tensors().values())


class FrameStore:
    """Points of all frames; those not in use lie in files, so that memory does not grow with frames."""

    def __init__(
        self, scratch: Path, frames: int, make: Callable[[int], FramePoints], memory_mb: int, saved: Path | None
    ) -> None:
        """Open a store.

        Args:
            scratch: folder for points that leave memory between checkpoints; emptied here.
            frames: number of frames.
            make: gives the points of a frame that was never trained.
            memory_mb: bound on points kept in memory.
            saved: a folder written by :meth:`save`, to go on from.
        """
        self._scratch = scratch
        self._make = make
        self._budget = memory_mb * 2**20
        self._saved = saved
        self._kept: OrderedDict[int, FramePoints] = OrderedDict()
        self._spilled: set[int] = set()
        self.frames = frames
        scratch.mkdir(parents=True, exist_ok=True)
        for stale in scratch.glob("*.safetensors"):
            stale.unlink()

    @property
    def kept(self) -> int:
        """Number of frames in memory."""
        return len(self._kept)

    def get(self, frame: int) -> FramePoints:
        """The points of a frame, to be changed in place until the next call."""
        if frame in self._kept:
            self._kept.move_to_end(frame)
            return self._kept[frame]
        points = self._loaded(frame).in_own_pages()
        self._kept[frame] = points
        while len(self._kept) > 1 and len(self._kept) * points.nbytes > self._budget:
            oldest, dropped = self._kept.popitem(last=False)
            save_file(dropped.tensors(), self._scratch / _file_name(oldest))
            self._spilled.add(oldest)
        return points

    def save(self, folder: Path) -> None:
        """Write every frame below ``folder``, one at a time."""
        for frame in range(self.frames):
            with atomic_path(folder / _file_name(frame)) as temporary:
                self._write(frame, temporary)
        self._saved = folder

    def _write(self, frame: int, target: Path) -> None:
        """Write a frame's file: as it is in memory, or else a copy of the newest file, unread."""
        file = self._file(frame)
        if frame in self._kept or file is None:
            save_file((self._kept.get(frame) or self._make(frame)).tensors(), target)
        else:
            shutil.copyfile(file, target)

    def _loaded(self, frame: int) -> FramePoints:
        file = self._file(frame)
        if file is None:
            return self._make(frame)
        named = load_file(file)
        if "spacing" not in named:  # written before points had spacings of their own
            named["spacing"] = self._make(frame).spacing
        return FramePoints.from_tensors(named)

    def _file(self, frame: int) -> Path | None:
        """Where a frame's points were last written, if ever."""
        folder = self._scratch if frame in self._spilled else self._saved
        return None if folder is None else folder / _file_name(frame)


def _no_history(count: int) -> dict[str, Tensor]:
    """Of points that have done nothing yet."""
    history = {name: torch.zeros(count) for name in ("error", "shown", "born")}
    lasting = torch.zeros(count, dtype=torch.bool)
    return {**history, "lasting": lasting, "age": torch.zeros(()), "first": torch.tensor(float(count))}


def _file_name(frame: int) -> str:
    return f"{frame:06d}.safetensors"


def _in_own_pages(value: Tensor) -> Tensor:
    return torch.from_numpy(in_own_pages(value.numpy()))


def _below(prefix: str, named: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in named.items() if name.startswith(prefix)}
