"""Predict the duration, data traffic and price of each stage of ``fourd make`` for a capture, a config and a cluster.

    python tools/measurements/cluster/cost_model.py --cameras 60 --frames 18000 --size 3840 2160 --nodes 16 --cores 16

The coefficients of two stages, "import" and "mattes", are constants of fourd.pipeline. All other coefficients were
measured with measure_costs.py and are stored in costs.json. Coefficients that are times are CPU seconds of one core of
the machine on which they were measured. Use --speed for other machines: if their cores are twice as fast, pass
--speed 2. Use --price to pass the hourly price of a node.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fourd.pipeline.stages.mattes import MATTE_S_PER_MP
from fourd.pipeline.workload import MATCH_S_PER_MP, SAMPLED_FRAMES
from fourd.reconstruction.model.config import ModelConfig
from fourd.reconstruction.training.config import SegmentConfig, TrainConfig
from fourd.reconstruction.training.segments.plan import SegmentPlan

BYTES_PER_PIXEL = 4
"""Bytes per pixel in the cache of decoded images, which stores RGB and the matte."""
COSTS = Path(__file__).with_name("costs.json")


@dataclass(frozen=True)
class Costs:
    """Coefficients of the cost model. Times are CPU seconds of one core. In the names, ``point`` means one point in one
    frame, and ``colour`` means the colour of such a point in one training camera.

    Attributes:
        stage_start_s: starting a stage's process.
        decode_s_per_mp: decoding the frames of a video in order, per megapixel.
        seek_s_per_mp: decoding random frames of a video with a key frame every 60 frames, per megapixel.
        train_start_s: starting a training run and writing its first checkpoint.
    """

    stage_start_s: float
    decode_s_per_mp: float
    seek_s_per_mp: float
    carve_s_per_image: float
    carve_s_per_point: float
    train_start_s: float
    step_s: float
    step_s_per_point: float
    step_s_per_mp: float
    bake_s_per_frame: float
    bake_s_per_colour: float
    matte_bytes_per_mp: float
    hull_bytes_per_point: float
    checkpoint_bytes: float
    checkpoint_bytes_per_point: float
    scene_bytes_per_point: float
    scene_bytes_per_colour: float

    @classmethod
    def load(cls, path: Path = COSTS) -> Costs:
        """Read a file that measure_costs.py has written."""
        return cls(**json.loads(path.read_text()))


@dataclass(frozen=True)
class Capture:
    """A capture and the config of its training. The training divides the frames into segments, and trains each segment
    separately.

    Attributes:
        cameras: number of cameras.
        frames: number of frames of each camera.
        image_mp: size of an image in megapixels.
        video_mbits: data rate of each video in megabits per second.
        fps: frames per second.
        has_mattes: whether the capture has mattes.
        has_videos: whether the capture is imported from videos, instead of having image files.
        scale: scale of the images in training.
        points: number of points per frame.
        segment: maximum number of frames of a segment.
        steps: training steps of a segment.
    """

    cameras: int
    frames: int
    image_mp: float
    video_mbits: float = 100.0
    fps: float = 30.0
    has_mattes: bool = False
    has_videos: bool = True
    scale: float = 1.0
    points: int = 65536
    segment: int = 120
    steps: int = 4000

    @property
    def segments(self) -> tuple[range, ...]:
        """The frames of each segment. Successive segments share some frames."""
        return SegmentPlan.divide(self.frames, SegmentConfig(frames=self.segment)).ranges

    @property
    def decoded_mp(self) -> float:
        """Megapixels of video that are decoded in each training step. This is 0 for image files, which are cheap to
        decode, and for videos whose images fit into the cache of decoded images."""
        image_bytes = BYTES_PER_PIXEL * 1e6 * self.image_mp * self.scale**2
        fits = self.segment * self.cameras * image_bytes <= TrainConfig().memory_mb * 2**20
        return 0.0 if fits or not self.has_videos else (1 + ModelConfig().neighbours) * self.image_mp

    @property
    def frame_points(self) -> int:
        """Number of points of all frames together."""
        return self.frames * self.points


@dataclass(frozen=True)
class Machines:
    """A cluster.

    Attributes:
        nodes: number of nodes.
        cores: number of cores per node, as Ray counts them.
        real_cores: number of physical cores if one machine simulates all nodes, or None if each node is a separate
            machine.
        speed: speed of a core, relative to a core of the machine on which the coefficients were measured.
    """

    nodes: int
    cores: int
    real_cores: float | None = None
    speed: float = 1.0

    @property
    def total_cores(self) -> float:
        """Number of physical cores in all nodes together."""
        return min(self.nodes * self.cores, self.real_cores or float("inf"))

    @property
    def node_cores(self) -> float:
        """Number of physical cores in one node."""
        return min(self.cores, self.real_cores or float("inf"))


@dataclass(frozen=True)
class StageCost:
    """The cost of a stage.

    Attributes:
        name: name of the stage.
        core_s: CPU seconds of one core.
        wall_s: duration on the cluster in seconds.
        read_bytes: bytes that the stage reads from the shared storage.
        written_bytes: bytes that the stage writes to the shared storage.
    """

    name: str
    core_s: float
    wall_s: float
    read_bytes: float
    written_bytes: float


def predict(costs: Costs, capture: Capture, machines: Machines) -> tuple[StageCost, ...]:
    """Return the cost of each stage, in the order in which the stages run."""
    images = capture.cameras * capture.frames
    whole_mp = images * capture.image_mp
    videos = capture.cameras * capture.frames / capture.fps * capture.video_mbits * 1e6 / 8
    mattes = whole_mp * costs.matte_bytes_per_mp
    hull = capture.frame_points * costs.hull_bytes_per_point
    lengths = [len(frames) for frames in capture.segments]
    checkpoints = [
        costs.checkpoint_bytes + length * capture.points * costs.checkpoint_bytes_per_point for length in lengths
    ]
    colours = capture.frame_points * capture.cameras
    scene = capture.frame_points * costs.scene_bytes_per_point + colours * costs.scene_bytes_per_colour
    stages = []

    def add(name: str, core_s: float, parallel: float, read: float, written: float) -> None:
        """Add a stage that runs alone and uses ``parallel`` cores."""
        scaled = core_s / machines.speed
        start = costs.stage_start_s / machines.speed
        stages.append(StageCost(name, scaled + start, scaled / parallel + start, read, written))

    sampled_mp = min(SAMPLED_FRAMES, capture.frames) * capture.cameras * capture.image_mp
    if capture.has_videos:
        # No bytes are written, because an imported capture contains only links to the videos.
        add("import", MATCH_S_PER_MP * sampled_mp, 1, videos, 0)
    if not capture.has_mattes:
        add("mattes", MATTE_S_PER_MP * whole_mp, machines.node_cores, videos, mattes)
    carving = images * costs.carve_s_per_image + capture.frame_points * costs.carve_s_per_point
    add("carving", carving, machines.node_cores, mattes, hull)
    slots = machines.nodes * machines.cores
    segments = [core_s / machines.speed for core_s in segments_core_s(costs, capture, slots)]
    wall_s = makespan(segments, slots, machines.total_cores)
    # Segments share frames with their neighbours, so these frames are read more than once.
    repeated = sum(lengths) / capture.frames
    read = (videos + mattes + hull) * repeated
    stages.append(StageCost("training", sum(segments), wall_s, read, sum(checkpoints)))
    baking = capture.frames * costs.bake_s_per_frame + colours * costs.bake_s_per_colour
    add("baking", baking, 1, sum(checkpoints) + videos, scene)
    return tuple(stages)


def segments_core_s(costs: Costs, capture: Capture, slots: int) -> list[float]:
    """Return the CPU seconds to train each segment. The segments are distributed over ``slots`` processes. Each process
    has one core and trains its segments one after the other. The time for the first segment of a process includes the
    time to start the process."""
    core_s, count = segment_core_s(costs, capture), len(capture.segments)
    return [core_s + costs.stage_start_s if index < slots else core_s for index in range(count)]


def segment_core_s(costs: Costs, capture: Capture) -> float:
    """Return the CPU seconds to train one segment on one core, without the time to start the process."""
    step = (
        costs.step_s
        + costs.step_s_per_point * capture.points
        + costs.step_s_per_mp * capture.image_mp * capture.scale**2
        + costs.seek_s_per_mp * capture.decoded_mp
    )
    return costs.train_start_s + capture.steps * step


def makespan(works: Sequence[float], slots: int, cores: float) -> float:
    """Return the time in seconds until all tasks are done.

    Args:
        works: core seconds of each task, in the order in which the tasks start. A task uses at most one core.
        slots: number of tasks that run at the same time.
        cores: number of cores, which the running tasks share equally.
    """
    waiting, running, now = list(works), list[float](), 0.0
    while waiting or running:
        while waiting and len(running) < slots:
            running.append(waiting.pop(0))
        share = min(1.0, cores / len(running))
        first = min(running)
        now += first / share
        running = [left - first for left in running if left - first > 1e-9]
    return now


def main() -> None:
    arguments = _parse_arguments()
    width, height = arguments.size
    capture = Capture(
        arguments.cameras,
        arguments.frames,
        width * height / 1e6,
        video_mbits=arguments.video_mbits,
        has_mattes=arguments.mattes,
        scale=arguments.scale,
        points=arguments.points,
        segment=arguments.segment,
        steps=arguments.steps,
    )
    machines = Machines(arguments.nodes, arguments.cores, speed=arguments.speed)
    stages = predict(Costs.load(), capture, machines)
    print(table(stages, machines, arguments.price))


def table(stages: Sequence[StageCost], machines: Machines, price: float | None) -> str:
    """Return a Markdown table. ``price`` is the hourly price of a node, or None."""
    lines = ["| stage | core hours | hours | share of time | read, GB | written, GB |", "|---|---|---|---|---|---|"]
    total = StageCost(
        "all",
        sum(stage.core_s for stage in stages),
        sum(stage.wall_s for stage in stages),
        sum(stage.read_bytes for stage in stages),
        sum(stage.written_bytes for stage in stages),
    )
    for stage in (*stages, total):
        lines.append(
            f"| {stage.name} | {stage.core_s / 3600:,.1f} | {stage.wall_s / 3600:,.1f} | "
            f"{stage.wall_s / total.wall_s:.0%} | {stage.read_bytes / 1e9:,.0f} | {stage.written_bytes / 1e9:,.0f} |"
        )
    if price is not None:
        hours = total.wall_s / 3600
        lines.append(f"\n{machines.nodes} nodes for {hours:,.1f} hours: {machines.nodes * hours * price:,.0f}")
    return "\n".join(lines)


def _parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cameras", type=int, required=True, help="number of cameras")
    parser.add_argument("--frames", type=int, required=True, help="frames of each camera")
    parser.add_argument("--size", type=int, nargs=2, required=True, help="width and height of the images in pixels")
    parser.add_argument(
        "--video-mbits",
        type=float,
        default=Capture.video_mbits,
        help="megabits per second of a video (default %(default)s)",
    )
    parser.add_argument("--mattes", action="store_true", help="the capture has mattes")
    parser.add_argument(
        "--scale", type=float, default=Capture.scale, help="scale of the images in training (default %(default)s)"
    )
    parser.add_argument("--points", type=int, default=Capture.points, help="points per frame (default %(default)s)")
    parser.add_argument(
        "--segment", type=int, default=Capture.segment, help="maximum frames per segment (default %(default)s)"
    )
    parser.add_argument(
        "--steps", type=int, default=Capture.steps, help="training steps per segment (default %(default)s)"
    )
    parser.add_argument("--nodes", type=int, default=1, help="number of nodes (default 1)")
    parser.add_argument("--cores", type=int, default=2, help="cores per node (default 2)")
    parser.add_argument("--speed", type=float, default=1.0, help="speed of a core, relative to the measured core")
    parser.add_argument("--price", type=float, help="price of one hour of a node, in any currency")
    return parser.parse_args()


if __name__ == "__main__":
    main()
