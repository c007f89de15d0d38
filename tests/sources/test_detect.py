"""Formats are found from content, folders are walked."""

from __future__ import annotations

from pathlib import Path

import pytest

from hbbatch.errors import SourceError
from hbbatch.sources.base import SourceOptions
from hbbatch.sources.detect import open_sources
from tests import logs
from tests.kitti_folders import write_sequence


def write_log(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return logs.LogWriter().add("/d", 1, logs.detections(1, "map", [])).write(path)


def formats(path: Path) -> list[str]:
    return [source.format_name for source in open_sources(path, SourceOptions())]


def test_content_decides_not_the_name(tmp_path: Path) -> None:
    assert formats(write_log(tmp_path / "drive.bag")) == ["mcap"]
    assert formats(write_sequence(tmp_path / "drive.mcap")) == ["kitti_tracking"]


def test_folders_are_walked_in_order(tmp_path: Path) -> None:
    for name in ("b/2.mcap", "b/1.mcap", "a.mcap", ".hidden/3.mcap"):
        write_log(tmp_path / name)
    write_sequence(tmp_path / "kitti" / "training")
    (tmp_path / "notes.txt").write_text("nothing to read here")
    found = [source.path.name for source in open_sources(tmp_path, SourceOptions())]
    assert found == ["a.mcap", "1.mcap", "2.mcap", "training"]


def test_links_in_circles_end(tmp_path: Path) -> None:
    write_log(tmp_path / "drive.mcap")
    (tmp_path / "again").symlink_to(tmp_path)
    assert formats(tmp_path) == ["mcap"]


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda _: None, "does not exist"),
        (lambda path: path.mkdir(), "an empty folder"),
        (lambda path: path.touch(), "an empty file"),
        (lambda path: path.write_text("hello"), "an unknown format"),
        (lambda path: (path / "x").mkdir(parents=True), "a folder with nothing in it"),
    ],
)
def test_what_is_not_understood_is_named(tmp_path: Path, make: object, expected: str) -> None:
    make(tmp_path / "thing")  # type: ignore[operator]
    with pytest.raises(SourceError, match=rf"thing: {expected}"):
        open_sources(tmp_path / "thing", SourceOptions())


@pytest.mark.parametrize("name", ["x.mcap", "x.bag", "x.db3", "x.mcap.zst", "x.db3.zstd"])
@pytest.mark.parametrize(
    ("content", "expected"), [(b"", "an empty file"), (b"\x17\x42", "an unknown format")]
)
def test_a_damaged_log_beside_others_fails_alone_and_is_named(
    tmp_path: Path, name: str, content: bytes, expected: str
) -> None:
    write_log(tmp_path / "good.mcap")
    (tmp_path / name).write_bytes(content)
    good, bad = open_sources(tmp_path, SourceOptions())
    assert good.format_name == "mcap"
    for read in (bad.sequences, bad.describe):
        with pytest.raises(SourceError, match=rf"{name}: {expected}\. Can be read: "):
            read()


def test_a_file_that_cannot_be_opened_fails_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_log(tmp_path / "good.mcap")
    closed = write_log(tmp_path / "shut.mcap")
    opened = Path.open

    def refusing(path: Path, *arguments: str) -> object:
        if path == closed:
            raise PermissionError(13, "Permission denied", str(path))
        return opened(path, *arguments)

    monkeypatch.setattr(Path, "open", refusing)
    good, bad = open_sources(tmp_path, SourceOptions())
    assert good.format_name == "mcap"
    with pytest.raises(SourceError, match=r"shut\.mcap: cannot be read \(Permission denied\)"):
        bad.sequences()
