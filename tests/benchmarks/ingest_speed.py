"""How fast logs are read, and in how much memory. Run by hand, from the root of the repository:

    OMP_NUM_THREADS=1 python -m tests.benchmarks.ingest_speed

Each figure is taken in a process of its own, in seconds of CPU (all threads), so that what else the
machine does counts little; the best of three counts. See
docs/performance_ingest.md for what is compared and what came out.
"""

from __future__ import annotations

import argparse
import multiprocessing
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory

from hbbatch.runner.ingest import ingest
from tests import logs

_BOXES = 20
_CLASSES = ("car", "pedestrian", "truck", "bicycle")
_ZEROS = 65_536


def write_detections(path: Path, messages: int) -> Path:
    """A drive of vision_msgs/Detection3DArray with 20 boxes each, and /tf, in zstd chunks."""
    random = np.random.default_rng(0)
    log = logs.LogWriter()
    for k in range(messages):
        time_ns = 10**18 + k * 10**8
        boxes = random.uniform(1.0, 50.0, (_BOXES, 7))
        items = [
            logs.detection(box, [(_CLASSES[n % len(_CLASSES)], float(box[0]) / 50)])
            for n, box in enumerate(boxes)
        ]
        log.add("/detections", time_ns, logs.detections(time_ns, "lidar", items))
        log.add("/tf", time_ns, logs.transform(time_ns, "map", "lidar", (k, 0, 0)))
    return log.write(path)


class _SparseFile:
    """A file in which long runs of zeros are holes."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def write(self, data: bytes) -> int:
        for start in range(0, len(data), _ZEROS):
            block = data[start : start + _ZEROS]
            if block.count(0) == len(block):
                self._file.seek(len(block), 1)
            else:
                self._file.write(block)
        return len(data)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def write_clouds(path: Path, gigabytes: float) -> Path:
    """Detections among point clouds of zeros, 2 MB each, in chunks of 4 MB."""
    kinds = {
        k: logs.definition(k)
        for k in ("vision_msgs/msg/Detection3DArray", "tf2_msgs/msg/TFMessage")
    }
    cloud = bytes(2_000_000)
    with path.open("wb") as file:
        writer = Writer(_SparseFile(file), 4 * 2**20, CompressionType.NONE, enable_crcs=False)
        writer.start(profile="ros2")
        schemas = {k: writer.register_schema(k, "ros2msg", t.encode()) for k, t in kinds.items()}
        schemas["cloud"] = writer.register_schema("sensor_msgs/msg/PointCloud2", "ros2msg", b"")
        found, tf, points = (
            writer.register_channel(topic, "cdr", schema)
            for topic, schema in zip(("/found", "/tf", "/points"), schemas.values(), strict=True)
        )
        for k in range(int(gigabytes * 1e9) // len(cloud)):
            time_ns = 10**18 + k * 10**8
            items = [logs.detection((10, 2, 0, 4, 2, 1.5, 0), [("car", 0.9)])] * _BOXES
            for channel, message in (
                (found, logs.detections(time_ns, "lidar", items)),
                (tf, logs.transform(time_ns, "map", "lidar", (k, 0, 0))),
            ):
                data = bytes(logs.STORE.serialize_cdr(message, message.__msgtype__))
                writer.add_message(channel, time_ns, data, time_ns)
            writer.add_message(points, time_ns, cloud, time_ns)
        writer.finish()
    return path


def bare_iteration(path: Path, _: Path) -> int:
    """mcap's StreamReader over all records, nothing decoded."""
    with path.open("rb") as file:
        return sum(isinstance(record, Message) for record in StreamReader(file).records)


def mcap_ros2_support(path: Path, _: Path) -> int:
    """mcap-ros2-support's decoder on all messages."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return sum(1 for _ in reader.iter_decoded_messages())


def hbbatch_ingest(path: Path, out: Path) -> int:
    """All of `hbbatch ingest`: boxes, poses, Parquet, hashes."""
    report = ingest([path], out, force=True)
    assert report.errors == []
    return 2 * sum(outcome.row["frames"] for outcome in report.outcomes if outcome.row)


def _measure(work: Callable[[Path, Path], int], path: Path, out: Path, pipe: Any) -> None:
    started = time.process_time()
    messages = work(path, out)
    seconds = time.process_time() - started
    pipe.send((messages, seconds, _peak_rss_mb()))


def _peak_rss_mb() -> float:
    """Of this process alone: getrusage counts what its parent had when it was started."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024


def measured(work: Callable[[Path, Path], int], path: Path, runs: int) -> tuple[float, float]:
    """Messages a second and peak RSS (MB), best of some runs in processes of their own."""
    context = multiprocessing.get_context("spawn")
    best, peak = 0.0, 0.0
    for _ in range(runs):
        out = Path(tempfile.mkdtemp())
        here, there = context.Pipe()
        process = context.Process(target=_measure, args=(work, path, out, there))
        process.start()
        messages, seconds, rss_mb = here.recv()
        process.join()
        shutil.rmtree(out)
        best, peak = max(best, messages / seconds), max(peak, rss_mb)
    return best, peak


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the logs, measure, print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--messages", type=int, default=10_000)
    parser.add_argument("--gigabytes", type=float, default=4.0)
    parser.add_argument("--runs", type=int, default=3)
    asked = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        path = write_detections(Path(folder) / "drive.mcap", asked.messages)
        rates = {}
        for work in (bare_iteration, mcap_ros2_support, hbbatch_ingest):
            rates[work], peak = measured(work, path, asked.runs)
            print(f"{work.__name__:20} {rates[work]:10.0f} messages/s {peak:6.0f} MB")
        print(f"time of bare iteration x {rates[bare_iteration] / rates[hbbatch_ingest]:.2f}")
        print(f"mcap-ros2-support x {rates[hbbatch_ingest] / rates[mcap_ros2_support]:.1f}")
        clouds = write_clouds(Path(folder) / "clouds.mcap", asked.gigabytes)
        rate, peak = measured(hbbatch_ingest, clouds, 1)
        size = clouds.stat().st_size / 1e9
        print(f"{size:.1f} GB of point clouds: {rate:.0f} messages/s, peak RSS {peak:.0f} MB")


if __name__ == "__main__":
    main()
