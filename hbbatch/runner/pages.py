"""Markdown pages that commands put their tables into, between two lines that stay."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hbbatch.dataset import write_aside
from hbbatch.errors import ConfigError


@dataclass(frozen=True)
class TablePage:
    """A page and the lines between which tables stand; a page that is not there yet gets both.

    Attributes:
        path: of the page.
        first, last: the lines, which nothing else in the page holds.
    """

    path: Path
    first: str
    last: str

    def check(self) -> None:
        """Whether tables could be put there: worth knowing before they are measured.

        Raises:
            ConfigError: the page exists and lacks one of the lines.
        """
        self._around()

    def put(self, tables: str) -> None:
        """Replace what stands between the lines.

        Raises:
            ConfigError: as of `check`.
        """
        before, after = self._around()
        with write_aside(self.path) as aside:
            aside.write_text(f"{before}{self.first}\n\n{tables.strip()}\n\n{self.last}{after}")

    def _around(self) -> tuple[str, str]:
        """What stands before the first line and behind the last."""
        if not self.path.exists():
            return "", "\n"
        before, first, rest = self.path.read_text().partition(self.first)
        _, last, after = rest.partition(self.last)
        if not (first and last):
            raise ConfigError(
                f"{self.path}: holds no lines {self.first!r} and {self.last!r}. "
                "Add both to the page."
            )
        return before, after


def bench_page(path: Path) -> TablePage:
    """Where `hbbatch bench` and the benchmarks beside the tests put what they measured."""
    return TablePage(path, "<!-- hbbatch bench: begin -->", "<!-- hbbatch bench: end -->")


def study_page(path: Path, name: str) -> TablePage:
    """Where a study puts its tables.

    Args:
        path: of the page.
        name: of the study, which its lines hold.
    """
    return TablePage(path, f"<!-- study: {name} -->", f"<!-- end of study: {name} -->")
