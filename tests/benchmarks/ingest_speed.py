"""How fast logs are read, and in how much memory. Run by hand, from the root of the repository:

    OMP_NUM_THREADS=1 python -m tests.benchmarks.ingest_speed --markdown docs/performance_ingest.md

Each figure is seconds of CPU (all threads) of a process of its own, which has imported what it
needs. What is compared takes turns, round by round, so that a machine that is busy for a while is
busy for all of it; medians count. See docs/performance_ingest.md for what came out.
"""

from __future__ import annotations

import argparse
import multiprocessing
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, BinaryIO

import numpy as np
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory

from hbbatch.cli.main import prepare_libraries
from hbbatch.runner.bench_report import Table, as_markdown
from hbbatch.runner.ingest import ingest
from hbbatch.runner.pages import bench_page
from tests import logs
from tests.benchmarks.ingest_split import split

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


@dataclass(frozen=True)
class Sample:
    """One process.

    Attributes:
        messages: what it read.
        seconds: CPU time.
        peak_rss_mb: the most memory it had.
        parts: seconds by part, where they were asked for.
    """

    messages: int
    seconds: float
    peak_rss_mb: float
    parts: dict[str, float]


Work = Callable[[Path, Path], tuple[int, dict[str, float]]]


def bare_iteration(path: Path, _: Path) -> tuple[int, dict[str, float]]:
    """mcap's StreamReader over all records, nothing decoded."""
    with path.open("rb") as file:
        return sum(isinstance(record, Message) for record in StreamReader(file).records), {}


def checked_iteration(path: Path, _: Path) -> tuple[int, dict[str, float]]:
    """The same with the checksums validated, as an ingest does."""
    with path.open("rb") as file:
        found = StreamReader(file, validate_crcs=True).records
        return sum(isinstance(record, Message) for record in found), {}


def mcap_ros2_support(path: Path, _: Path) -> tuple[int, dict[str, float]]:
    """mcap-ros2-support's decoder on all messages."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return sum(1 for _ in reader.iter_decoded_messages()), {}


def hbbatch_ingest(path: Path, out: Path) -> tuple[int, dict[str, float]]:
    """All of `hbbatch ingest`: boxes, poses, Parquet, hashes."""
    report = ingest([path], out, force=True)
    assert report.errors == []
    return 2 * sum(outcome.row["frames"] for outcome in report.outcomes if outcome.row), {}


def split_ingest(path: Path, out: Path) -> tuple[int, dict[str, float]]:
    """The same with its parts timed, which takes a little longer."""
    return 0, split(lambda: hbbatch_ingest(path, out))


def _measure(work: Work, path: Path, out: Path, pipe: Any) -> None:
    started = time.process_time()
    messages, parts = work(path, out)
    seconds = time.process_time() - started
    pipe.send(Sample(messages, seconds, _peak_rss_mb(), parts))


def _peak_rss_mb() -> float:
    """Of this process alone: getrusage counts what its parent had when it was started."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024


def measured(work: Work, path: Path) -> Sample:
    """One piece of work in a process of its own."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    with tempfile.TemporaryDirectory() as out:
        process = context.Process(target=_measure, args=(work, path, Path(out), there))
        process.start()
        sample: Sample = here.recv()
        process.join()
    return sample


def in_turns(works: Sequence[Work], path: Path, rounds: int) -> dict[Work, list[Sample]]:
    """All pieces of work, one after the other, some times over."""
    samples: dict[Work, list[Sample]] = {work: [] for work in works}
    for _ in range(rounds):
        for work in works:
            samples[work].append(measured(work, path))
    return samples


def speed_table(path: Path, rounds: int, slow_rounds: int) -> Table:
    """What an ingest takes, against reading alone and against another decoder."""
    samples = in_turns((bare_iteration, checked_iteration, hbbatch_ingest), path, rounds)
    samples |= in_turns((mcap_ros2_support,), path, slow_rounds)
    seconds = {work: median(s.seconds for s in taken) for work, taken in samples.items()}
    ratios = [
        ours.seconds / bare.seconds
        for ours, bare in zip(samples[hbbatch_ingest], samples[bare_iteration], strict=True)
    ]
    titles = {
        bare_iteration: "`StreamReader`, nothing decoded",
        checked_iteration: "`StreamReader`, checksums validated",
        hbbatch_ingest: "`hbbatch ingest`",
        mcap_ros2_support: "mcap-ros2-support, decoding only",
    }
    rows = [
        (
            title,
            f"{1e3 * seconds[work]:,.0f}",
            f"{samples[work][0].messages / seconds[work]:,.0f}",
            f"{seconds[work] / seconds[bare_iteration]:.2f}",
            f"{seconds[mcap_ros2_support] / seconds[work]:.1f}",
        )
        for work, title in titles.items()
    ]
    return Table(
        "Speed",
        ("", "ms of CPU", "messages/s", "time, bare = 1", "messages/s, mcap-ros2-support = 1"),
        rows,
        f"{samples[hbbatch_ingest][0].messages:,} messages, {path.stat().st_size / 1e6:.0f} MB. "
        f"Medians of {rounds} rounds ({slow_rounds} of mcap-ros2-support). Ingest against bare "
        f"iteration round by round: {min(ratios):.2f} to {max(ratios):.2f}.",
    )


def split_table(path: Path, rounds: int) -> Table:
    """Where the time of an ingest goes."""
    taken = [measured(split_ingest, path) for _ in range(rounds)]
    parts = {name: median(s.parts[name] for s in taken) for name in taken[0].parts}
    total = sum(parts.values())
    ranked = sorted(parts.items(), key=lambda item: -item[1])
    rows = [(name, f"{1e3 * part:.1f}", f"{100 * part / total:.0f} %") for name, part in ranked]
    return Table(
        "Where the time of an ingest goes",
        ("part", "ms of CPU", "share"),
        rows,
        f"Each part without those within it, medians of {rounds} processes.",
    )


def memory_table(path: Path) -> Table:
    """How much memory a log of point clouds takes."""
    sample = measured(hbbatch_ingest, path)
    row = (f"{path.stat().st_size / 1e9:.1f} GB", f"{sample.peak_rss_mb:.0f} MB")
    return Table("Memory", ("log of point clouds", "most memory (`VmHWM`)"), [row])


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the logs, measure, print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--messages", type=int, default=10_000)
    parser.add_argument("--gigabytes", type=float, default=4.0)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--slow-rounds", type=int, default=2, help="of mcap-ros2-support")
    parser.add_argument("--markdown", type=Path, help="document to write the tables into")
    asked = parser.parse_args(arguments)
    if asked.markdown:
        bench_page(asked.markdown).check()
    prepare_libraries()  # in all processes that are measured, as the command line does
    with tempfile.TemporaryDirectory() as folder:
        path = write_detections(Path(folder) / "drive.mcap", asked.messages)
        tables = [speed_table(path, asked.rounds, asked.slow_rounds)]
        tables += [split_table(path, asked.rounds)]
        tables += [memory_table(write_clouds(Path(folder) / "clouds.mcap", asked.gigabytes))]
    print(as_markdown(tables))
    if asked.markdown:
        bench_page(asked.markdown).put(as_markdown(tables))


if __name__ == "__main__":
    main()
