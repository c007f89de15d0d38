"""The dataset folder: where each table lies, and how it is read and written safely."""

from hbbatch.dataset.atomic import locked, write_aside
from hbbatch.dataset.store import Dataset, Run

__all__ = ["Dataset", "Run", "locked", "write_aside"]
