"""A dataset that repeats others."""

from __future__ import annotations

from pathlib import Path

from hbbatch.config import TrackSettings
from hbbatch.runner.repeated import repeated_dataset
from hbbatch.runner.track import TrackRequest, track
from tests.runner.small_dataset import ECHO, make_dataset


def test_sequences_of_all_datasets_follow_one_another(tmp_path: Path) -> None:
    sources = [make_dataset(tmp_path / "x", "a", "b"), make_dataset(tmp_path / "y", "a")]
    repeated = repeated_dataset([s.root for s in sources], tmp_path / "r", sequences=5)
    assert repeated.sequence_ids() == ["x-a-0", "x-a-1", "x-b-0", "x-b-1", "y-a-0"]
    for new, old in (("x-b-1", sources[0].detections("b")), ("y-a-0", sources[1].detections("a"))):
        assert repeated.detections(new).equals(old)
    assert repeated.poses("x-a-1").equals(sources[0].poses("a"))


def test_each_once_is_a_dataset_of_all(tmp_path: Path) -> None:
    sources = [make_dataset(tmp_path / "x", "a"), make_dataset(tmp_path / "y", "a")]
    repeated = repeated_dataset([s.root for s in sources], tmp_path / "r")
    report = track(TrackRequest(repeated.root, TrackSettings(), run="r", workers=1), engine=ECHO)
    assert report.tracked == ("x-a-0", "y-a-0")
    assert not report.failed
    assert report.frames == sum(s.catalog()["frames"][0].as_py() for s in sources)
