"""Tables between two lines of a page."""

from __future__ import annotations

from pathlib import Path

import pytest

from hbbatch.errors import ConfigError
from hbbatch.runner.pages import bench_page, study_page


def test_tables_replace_what_stands_between_the_lines_and_nothing_else(tmp_path: Path) -> None:
    page = study_page(tmp_path / "page.md", "a.yaml")
    page.path.write_text(f"# Title\n\nHow.\n\n{page.first}\n| old |\n{page.last}\n\nThe end.\n")
    for _ in range(2):
        page.put("| new |\n")
    assert page.path.read_text() == (
        f"# Title\n\nHow.\n\n{page.first}\n\n| new |\n\n{page.last}\n\nThe end.\n"
    )


def test_a_page_that_is_not_there_yet_gets_the_lines(tmp_path: Path) -> None:
    page = bench_page(tmp_path / "page.md")
    page.check()
    assert not page.path.exists()
    page.put("| first |")
    page.put("| second |")
    assert page.path.read_text() == f"{page.first}\n\n| second |\n\n{page.last}\n"


def test_a_page_of_something_else_is_refused_and_stays(tmp_path: Path) -> None:
    page = study_page(tmp_path / "page.md", "a.yaml")
    study_page(page.path, "b.yaml").put("| other |")
    before = page.path.read_text()
    for attempt in (page.check, lambda: page.put("| new |")):
        with pytest.raises(ConfigError, match=r"holds no lines '<!-- study: a\.yaml -->'"):
            attempt()
    assert page.path.read_text() == before
