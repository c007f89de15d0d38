"""hbbatch: object tracks from logged drives, offline and in batches."""

__version__ = "0.1.0"
