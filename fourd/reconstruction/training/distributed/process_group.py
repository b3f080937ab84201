"""The process group that trains one model. In torchrun's terms, each process of the group is a rank."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import NoReturn

import torch
import torch.distributed as dist
from torch import Tensor

from fourd.base.errors import MAX_REASON, UserError, one_line
from fourd.base.processes.torchrun import rank_count

BACKEND = "gloo"
JOIN_SECONDS = 120.0
"""Maximum time in seconds to wait for an answer from the address of rank 0."""
WAIT = timedelta(days=7)
"""Maximum time for which a rank waits for the other ranks. It is long because the visual hull is carved only by
rank 0, while the others wait. If a rank fails, the others do not wait for it, because torchrun ends all ranks."""

RATE_EXPONENT = 0.5
"""The learning rates of dense parameters (all parameters except those of points) are multiplied by the number of ranks
to the power of this exponent."""


@dataclass(frozen=True)
class ProcessGroup:
    """The ranks that train one model together. A process that torchrun did not start forms a group of one rank, which
    does not communicate.

    In each update, every rank performs one training step on a view of one of its own frames. All ranks have the same
    dense parameters (networks, planes and corrections of cameras), because their gradients are averaged over the ranks
    before each update. Points and their gradients are never sent, because the points of a frame are stored and updated
    only by the rank that owns the frame.

    The gradients of all dense parameters are averaged in one all-reduce after the backward pass. torch's
    DistributedDataParallel is not used, because it requires one module that is called once per step. In contrast, a
    training step calls several methods of the model, and some parameters have a gradient only in some steps.

    Attributes:
        rank: number of this rank, from 0.
        size: number of ranks.
    """

    rank: int = 0
    size: int = 1

    @property
    def is_first(self) -> bool:
        """True for rank 0, which writes the logs and all parts of a checkpoint except the points of other ranks."""
        return self.rank == 0

    def own_frames(self, frames: int) -> range:
        """Return the indices of the frames that this rank owns. ``frames`` is the total number of frames of all
        ranks."""
        return range(self.rank, frames, self.size)

    def first_ranks_frame(self, frame: int) -> int:
        """Return the index of the last frame that rank 0 owns in the range from 0 to ``frame``, inclusive."""
        return frame - frame % self.size

    @property
    def rate_factor(self) -> float:
        """Factor that multiplies the learning rates of dense parameters. With several ranks, one update uses a view of
        each rank, so training performs fewer updates than a single process would with the same number of views. The
        factor compensates for this."""
        return self.size**RATE_EXPONENT

    @torch.no_grad()
    def average_gradients(self, parameters: Iterable[Tensor]) -> None:
        """Replace each gradient by its mean over all ranks. If only some ranks have a gradient of a parameter, the
        missing gradients count as zero. If no rank has one, the parameter remains without a gradient, so that its
        optimizer state does not change.

        All ranks must pass the same parameters in the same order. All parameters must have the same dtype.
        """
        if self.size == 1:
            return
        listed = list(parameters)
        # Gradients on a GPU are copied to the CPU, because the backend gloo sends only tensors in CPU memory.
        parts = [(torch.zeros_like(each) if each.grad is None else each.grad).cpu() for each in listed]
        has_gradient = torch.tensor([each.grad is not None for each in listed]).to(parts[0])
        sums = torch.cat([*(part.flatten() for part in parts), has_gradient])
        with self._all_ranks():
            dist.all_reduce(sums)
        *means, counts = sums.split([*(part.numel() for part in parts), len(listed)])
        for each, mean, count in zip(listed, means, counts.tolist(), strict=True):
            each.grad = (mean / self.size).view_as(each).to(each.device) if count > 0 else None

    @torch.no_grad()
    def broadcast_parameters(self, parameters: Iterable[Tensor]) -> None:
        """Copy the parameters of rank 0 to all other ranks."""
        for each in parameters if self.size > 1 else ():
            value = each.data.cpu()
            with self._all_ranks():
                dist.broadcast(value, 0)
            each.data.copy_(value)

    def longest(self, seconds: float) -> float:
        """Return the maximum of ``seconds`` over all ranks."""
        return self._maximum(seconds)

    def any(self, is_true: bool) -> bool:
        """Return true if the argument is true on at least one rank."""
        return self._maximum(float(is_true)) > 0

    def barrier(self) -> None:
        """Wait until all ranks have called this method."""
        if self.size > 1:
            with self._all_ranks():
                dist.barrier()

    def require_same(self, what: str, text: str) -> None:
        """End all ranks if the text of any rank differs from that of rank 0. The error message contains ``what`` (a
        name for the text), the rank whose text differs, and the first different line. All ranks must call this method.
        """
        if self.size == 1:
            return
        digest = torch.frombuffer(bytearray(hashlib.sha256(text.encode()).digest()), dtype=torch.uint8)
        digests = [torch.zeros_like(digest) for _ in range(self.size)]
        with self._all_ranks():
            dist.all_gather(digests, digest)
        others = [rank for rank, each in enumerate(digests) if not torch.equal(each, digests[0])]
        if not others:
            return
        other = others[0]
        got, host = self._broadcast_text(text, other), self._broadcast_text(platform.node(), other)
        lines = zip([*text.splitlines(), ""], [*got.splitlines(), ""], strict=False)
        wanted, found = next((pair for pair in lines if pair[0] != pair[1]), ("more lines", "fewer lines"))
        self.refuse(
            f"rank {other} on {host}: expected the {what} of rank 0 ('{wanted.strip()}'), got '{found.strip()}'; start "
            "all ranks with the same command, the same files and the same version of fourd"
        )

    def refuse(self, message: str) -> NoReturn:
        """End all ranks with a message that only rank 0 prints. All ranks must call this method.

        Raises UserError on rank 0, and SystemExit on the other ranks.
        """
        if self.is_first:
            raise UserError(message)
        raise SystemExit(2)

    @contextmanager
    def _all_ranks(self) -> Iterator[None]:
        """Run the ``with`` block, in which the ranks communicate. Raises UserError if another rank ends meanwhile."""
        try:
            yield
        except RuntimeError as error:
            raise UserError(
                f"expected an answer from all {self.size} ranks, got '{one_line(error, MAX_REASON)}'; see the message "
                "of the rank that ended first, then continue with --resume"
            ) from error

    def _maximum(self, value: float) -> float:
        if self.size == 1:
            return value
        result = torch.tensor([value], dtype=torch.float64)
        with self._all_ranks():
            dist.all_reduce(result, op=dist.ReduceOp.MAX)
        return float(result)

    def _broadcast_text(self, text: str, source: int) -> str:
        """Send the text of the rank ``source`` to all ranks, and return it."""
        content = torch.frombuffer(bytearray(text.encode() or b" "), dtype=torch.uint8)
        length = torch.tensor([len(content)])
        with self._all_ranks():
            dist.broadcast(length, source)
            if self.rank != source:
                content = torch.zeros(int(length), dtype=torch.uint8)
            dist.broadcast(content, source)
        return bytes(content.numpy()).decode()


ALONE = ProcessGroup()
"""The group of a process that trains alone."""


@contextmanager
def join_process_group() -> Iterator[ProcessGroup]:
    """Join the ranks that torchrun has started, for the duration of the ``with`` block.

    torchrun describes the ranks in the environment variables RANK, WORLD_SIZE, MASTER_ADDR and MASTER_PORT. If these
    are not set, the group has one rank.

    Raises:
        UserError: if the address of rank 0 does not answer. If the block raises a UserError on a rank other than 0, the
            number of the rank and the name of its machine are added to the message.
    """
    if rank_count() == 1:
        yield ALONE
        return
    address = f"{os.environ.get('MASTER_ADDR')}:{os.environ.get('MASTER_PORT')}"
    try:
        store, rank, size = next(iter(dist.rendezvous("env://", timeout=timedelta(seconds=JOIN_SECONDS))))
        dist.init_process_group(BACKEND, store=store, rank=rank, world_size=size, timeout=WAIT)
    except (dist.DistError, ValueError, RuntimeError) as error:
        raise UserError(
            f"{address}: expected rank 0 at this address, got no connection ({one_line(error, MAX_REASON)}); start all "
            "ranks with torchrun, with the same --rdzv-endpoint, and open this port"
        ) from error
    try:
        yield ProcessGroup(rank, size)
    except UserError as error:
        if rank == 0:
            raise
        raise UserError(f"rank {rank} on {platform.node()}: {error}") from error
    finally:
        dist.destroy_process_group()
