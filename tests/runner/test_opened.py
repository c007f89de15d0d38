"""Sources as given on the command line: read once, and no option that is of no use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hbbatch.dataset import Dataset
from hbbatch.errors import ExitStatus, HbbatchError, UsageError
from hbbatch.runner.info import describe_sources
from hbbatch.runner.ingest import ingest
from hbbatch.sources.base import SourceOptions
from hbbatch.sources.log import LogSequence, LogSource
from tests import logs
from tests.kitti_folders import write_sequence

SECOND = 1_000_000_000


def write_log(path: Path, *seconds: float, topics: tuple[str, ...] = ("/d",)) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    log = logs.LogWriter()
    for time_ns in (int(s * SECOND) for s in seconds or (1,)):
        for topic in topics:
            log.add(topic, time_ns, logs.detections(time_ns, "map", []))
    return log.write(path)


@pytest.mark.parametrize(
    ("options", "flags"),
    [
        (SourceOptions(topics=("/d",)), "--topic"),
        (SourceOptions(max_gap_s=1.0, ros_distro="foxy"), "--max-gap-s, --ros-distro"),
    ],
)
def test_options_for_logs_are_refused_where_there_is_none(
    tmp_path: Path, options: SourceOptions, flags: str
) -> None:
    source = write_sequence(tmp_path / "kitti")
    for command in (
        lambda: ingest([source], tmp_path / "o", options=options),
        lambda: describe_sources([source], options),
    ):
        with pytest.raises(UsageError, match=rf"^{flags}: of no use .*kitti_tracking: .*kitti\)"):
            command()
    assert not (tmp_path / "o").exists()


def test_detections_are_refused_where_there_are_only_logs(tmp_path: Path) -> None:
    log = write_log(tmp_path / "drive.mcap")
    with pytest.raises(UsageError, match=r"^--detections: of no use .*mcap: .*drive\.mcap\)"):
        ingest([log], tmp_path / "out", options=SourceOptions(tmp_path))


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (SourceOptions(message_paths=(Path("nowhere"),)), r"--msg-path nowhere: no \.msg files"),
        (SourceOptions(ros_distro="noble"), "--ros-distro noble is not known"),
        (SourceOptions(mappings=(Path("no.yaml"),)), r"no\.yaml: cannot be read"),
        (SourceOptions(classes=Path("no.yaml")), r"no\.yaml: cannot be read"),
    ],
)
def test_options_that_name_what_is_not_there(
    tmp_path: Path, options: SourceOptions, expected: str
) -> None:
    """Whether or not the log needs them."""
    log = write_log(tmp_path / "drive.mcap")
    with pytest.raises(UsageError, match=expected):
        ingest([log], tmp_path / "out", options=options)
    with pytest.raises(UsageError, match=expected):
        describe_sources([log], options)


def test_an_option_of_use_to_one_source_may_be_given_with_others(tmp_path: Path) -> None:
    kitti, log = write_sequence(tmp_path / "kitti"), write_log(tmp_path / "drive.mcap")
    report = ingest([kitti, log], tmp_path / "out", options=SourceOptions(topics=("/d",)))
    assert report.exit_status is ExitStatus.DONE


def test_a_source_given_twice_is_read_once(tmp_path: Path) -> None:
    log = write_log(tmp_path / "drives" / "drive.mcap")
    (tmp_path / "link.mcap").symlink_to(log)
    report = ingest([log, tmp_path / "link.mcap", log.parent], tmp_path / "out")
    assert [(o.sequence_id, o.status.value) for o in report.outcomes] == [("drive", "ingested")]


@pytest.mark.parametrize("method", ["sequences", "describe"])
def test_a_defect_costs_one_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    monkeypatch.delenv("HBBATCH_TRACEBACK", raising=False)
    good, bad = write_log(tmp_path / "good.mcap"), write_log(tmp_path / "bad.mcap")
    whole = getattr(LogSource, method)

    def broken(source: LogSource) -> object:
        if source.path == bad:
            raise KeyError("surprise")
        return whole(source)

    monkeypatch.setattr(LogSource, method, broken)
    if method == "describe":
        info = describe_sources([bad, good], SourceOptions())
        assert [d.path for d in info.descriptions] == [good]
        errors, status = info.errors, info.exit_status
    else:
        report = ingest([bad, good], tmp_path / "out")
        assert Dataset.open(tmp_path / "out").sequence_ids() == ["good"]
        errors, status = report.source_errors, report.exit_status
    [error] = map(str, errors)
    assert error.startswith(f"{bad}: KeyError: 'surprise'. This is a defect of hbbatch; ")
    assert "--traceback" in error
    assert status is ExitStatus.FAILED


def test_a_defect_while_reading_costs_one_sequence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HBBATCH_TRACEBACK", raising=False)
    sources = [write_log(tmp_path / f"{name}.mcap") for name in ("bad", "good")]
    whole = LogSequence.read

    def broken(sequence: LogSequence) -> object:
        return {}["surprise"] if sequence.sequence_id == "bad" else whole(sequence)

    monkeypatch.setattr(LogSequence, "read", broken)
    report = ingest(sources, tmp_path / "out")
    [error] = report.errors
    assert error.startswith(f"{sources[0]}: sequence bad: KeyError: 'surprise'. This is a defect")
    assert [o.status.value for o in report.outcomes] == ["failed", "ingested"]
    assert report.exit_status is ExitStatus.FAILED


def _die(_: object) -> None:
    os._exit(9)


def test_a_worker_that_is_killed_is_said_to_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hbbatch.runner.ingest.bring_up_to_date", _die)
    sources = [write_log(tmp_path / name) for name in ("a.mcap", "b.mcap")]
    with pytest.raises(HbbatchError, match=r"^a worker process was killed.*fewer --workers\.$"):
        ingest(sources, tmp_path / "out", workers=2)


# --- names ---------------------------------------------------------------------------------------


def test_parts_of_a_divided_log_do_not_replace_another_log(tmp_path: Path) -> None:
    """drive.mcap pauses: its parts would be drive-000 and drive-001, and there is a drive-001."""
    drive = write_log(tmp_path / "drive.mcap", 1, 1.1, 1.2, 100)
    other = write_log(tmp_path / "drive-001.mcap")
    report = ingest([drive, other], tmp_path / "out")
    assert report.errors == [
        f"{drive}: sequence drive-001 is also in {other}. Ingest one of them into another dataset "
        "(--dataset)."
    ]
    assert Dataset.open(tmp_path / "out").sequence_ids() == ["drive-001"]
    again = ingest([drive], tmp_path / "out")
    assert f"has a sequence drive-001 already, from {other}" in again.errors[0]
    assert Dataset.open(tmp_path / "out").sequence_ids() == ["drive-001"]
    assert ingest([drive], tmp_path / "out", force=True).errors == []
    assert Dataset.open(tmp_path / "out").sequence_ids() == ["drive-000", "drive-001"]


def test_a_divided_log_that_was_moved_is_the_same(tmp_path: Path) -> None:
    drive = write_log(tmp_path / "drive.mcap", 1, 1.1, 1.2, 100)
    ingest([drive], tmp_path / "out")
    (tmp_path / "moved").mkdir()
    moved = drive.rename(tmp_path / "moved" / "drive.mcap")
    assert ingest([moved], tmp_path / "out").errors == []


def test_topics_whose_names_become_the_same(tmp_path: Path) -> None:
    log = write_log(tmp_path / "drive.mcap", topics=("/a/b", "/a-b"))
    options = SourceOptions(topics=("/a/b", "/a-b", "/a/b"))
    report = ingest([log], tmp_path / "out", options=options)
    [error] = report.errors
    assert "sequence drive-a-b is also in" in error
    assert [o.status.value for o in report.outcomes] == ["ingested", "failed"]
