"""Runs stages as tasks of a Ray cluster. The nodes exchange results only through files on shared storage."""

from __future__ import annotations

import io
import logging
import os
import platform
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from fourd.base.errors import MAX_REASON, UserError, one_line
from fourd.base.version import __version__
from fourd.pipeline.runner import AnyStage
from fourd.pipeline.stage import Context

RETRIES = 3
"""Maximum number of restarts of a stage whose worker or node is lost. A restarted stage resumes its work."""


@dataclass(frozen=True)
class Job:
    """A stage and everything that a node needs to run it.

    Attributes:
        stage: the stage.
        cores: number of cores, which is also the number of threads and of processes that the stage may use.
        folder: working folder to which the stage's relative paths refer. None for a portable stage, which does not need
            the folders of the machine that created it.
        version: the version of fourd that created the stage.
    """

    stage: AnyStage
    cores: int
    folder: Path | None
    version: str


@dataclass(frozen=True)
class Outcome:
    """Result of a job: the node's name, the printed lines, and the error message if a UserError was raised."""

    node: str
    lines: tuple[str, ...] = ()
    error: str | None = None


def run_job(job: Job) -> Outcome:
    """Run a job in this process. The process may already have run other jobs, with different numbers of cores."""
    node = platform.node()
    if job.version != __version__:
        return Outcome(
            node, error=f"expected fourd {job.version}, got {__version__}; install the same version on all nodes"
        )
    _set_threads(job.cores)
    text = io.StringIO()
    try:
        if job.folder is not None:
            os.chdir(job.folder)
    except OSError:
        got = "no such folder; mount the storage of the capture and the scene at the same path on all nodes"
        return Outcome(node, error=f"{job.folder}: expected the working folder of fourd make, got {got}")
    try:
        job.stage.run(Context(Console(file=text, width=1000), job.cores))
    except UserError as error:
        return Outcome(node, tuple(text.getvalue().splitlines()), str(error))
    except KeyboardInterrupt:
        # If a user stops the training on the web page of ``fourd serve``, the stage raises a KeyboardInterrupt. It is
        # caught here, because Ray would otherwise report a cancelled task instead of the message below.
        stopped = "expected a stage that finishes, got one that was stopped; run the command again to resume"
        return Outcome(node, tuple(text.getvalue().splitlines()), stopped)
    return Outcome(node, tuple(text.getvalue().splitlines()))


def _set_threads(count: int) -> None:
    """Set the number of threads of this process."""
    # torch reads OMP_NUM_THREADS only when it is imported. Afterwards, torch.set_num_threads is needed.
    for name in ("OMP_NUM_THREADS", "FOURD_THREADS"):
        os.environ[name] = str(count)
    if torch := sys.modules.get("torch"):
        torch.set_num_threads(count)


class Cluster:
    """A Ray cluster to which this process is connected. :meth:`execute` runs stages on its nodes."""

    def __init__(self, ray: Any, segment_cores: int) -> None:
        """Use the cluster to which the module ``ray`` is connected.

        Args:
            ray: the module ray. The caller must have called ``ray.init``.
            segment_cores: number of cores for each parallel stage. Other stages use all cores of a node.

        Raises:
            UserError: if no node has ``segment_cores`` cores, or all nodes with cores have left the cluster.
        """
        self._ray = ray
        self._segment_cores = segment_cores
        cores = [int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]]
        self._node_cores = max(cores, default=0)
        if self._node_cores == 0:
            raise UserError(
                f"--ray: expected a cluster that has nodes with cores, got {len(cores)} nodes without cores; add one "
                "with ray start --address HOST:PORT"
            )
        if not 1 <= segment_cores <= self._node_cores:
            raise UserError(f"--ray-cores: expected 1 to {self._node_cores}, the cores of a node, got {segment_cores}")

    def execute(self, stages: Sequence[AnyStage], context: Context) -> Iterator[AnyStage]:
        """Run stages that do not depend on each other, and yield each as soon as it is finished.

        Raises:
            UserError: if a stage failed. The error is raised after all stages have ended, and its message names the
                stage and its node.
        """
        failures: list[str] = []
        finished = self._finished(stages, context, failures)
        yield from finished if len(stages) == 1 else context.track(finished, len(stages), "stages on the cluster")
        if failures:
            more = f" (and {len(failures) - 1} more stages failed)" if len(failures) > 1 else ""
            raise UserError(failures[0] + more)

    def _finished(self, stages: Sequence[AnyStage], context: Context, failures: list[str]) -> Iterator[AnyStage]:
        """Start the stages, and yield each when it is finished. Messages of failed stages are appended to
        ``failures``."""
        pending = {self._start(stage): stage for stage in stages}
        while pending:
            (reference, *_), _ = self._ray.wait(list(pending), num_returns=1)
            stage = pending.pop(reference)
            outcome = self._result(stage, reference)
            for line in outcome.lines:
                context.log(line)
            if outcome.error is None:
                yield stage
            else:
                failures.append(f"{stage.name} on node {outcome.node}: {outcome.error}")

    def _start(self, stage: AnyStage) -> Any:
        cores = self._segment_cores if stage.is_parallel else self._node_cores
        # A process that has trained a segment (a range of frames) is reused for other segments (max_calls=0), because a
        # new process needs seconds to import torch. After any other stage, the process ends, which frees its memory.
        calls = 0 if stage.is_parallel else 1
        task = self._ray.remote(num_cpus=cores, max_retries=RETRIES, max_calls=calls)(run_job)
        folder = None if stage.is_portable else Path.cwd()
        return task.options(name=stage.name).remote(Job(stage, cores, folder, __version__))

    def _result(self, stage: AnyStage, reference: Any) -> Outcome:
        try:
            return self._ray.get(reference)
        except self._ray.exceptions.RayTaskError as error:
            if isinstance(error.cause, ModuleNotFoundError):
                return Outcome("of the task", error=f"expected fourd {__version__}, got '{error.cause}'; install it")
            raise error.cause from error
        except self._ray.exceptions.RayError as error:
            reason = one_line(error, MAX_REASON)
            return Outcome(
                "of the task",
                error=f"expected a worker that finishes, got '{reason}' after {RETRIES} retries; check the memory of "
                "the nodes, and run the command again to resume",
            )


@contextmanager
def join_cluster(address: str, segment_cores: int) -> Iterator[Cluster]:
    """Connect to a Ray cluster for the duration of the ``with`` block.

    Args:
        address: HOST:PORT of a running cluster, or "auto" for the cluster that runs on this machine. If none runs,
            "auto" starts one on this machine and stops it at the end of the block.
        segment_cores: see :class:`Cluster`.

    Raises:
        UserError: if ray is not installed, or the address does not answer.
    """
    try:
        import ray
    except ModuleNotFoundError as error:
        raise UserError("--ray: expected the package ray, got none; pip install 'fourd[cluster]'") from error
    try:
        ray.init(
            address=None if address == "auto" else address,
            log_to_driver=False,
            logging_level=logging.ERROR,
            include_dashboard=False if address == "auto" else None,
        )
    except Exception as error:  # If a busy machine starts it too slowly, Ray raises the bare class Exception.
        fix = "run the command again when this machine is less busy" if address == "auto" else "use --ray auto"
        raise UserError(
            f"--ray: expected a Ray cluster at {address}, got '{one_line(error, MAX_REASON)}'; start one with "
            f"ray start --head, or {fix}"
        ) from error
    try:
        yield Cluster(ray, segment_cores)
    finally:
        ray.shutdown()
