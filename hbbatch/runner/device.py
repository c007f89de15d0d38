"""Where to compute, found out without loading torch on a machine that has no GPU."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Final

from hbbatch.config import DeviceName
from hbbatch.errors import UsageError

_DRIVERS: Final = ("libcuda.so.1", "nvcuda.dll")
"""What torch's CUDA looks for on Linux and on Windows, by the loader's own search path."""

_AMD_DRIVER: Final = Path("/dev/kfd")
"""Torch built for AMD's GPUs calls them cuda as well."""


def resolved_device(device: DeviceName) -> DeviceName:
    """`cpu` or `cuda`: what is asked for, or what `auto` stands for here.

    Torch takes a second to load, and a worker on a CPU needs nothing of it: it is asked only where
    a GPU's driver is there.

    Raises:
        UsageError: cuda is asked for and there is none.
    """
    if device == "cpu":
        return "cpu"
    if driver_found() and _torch_finds_a_gpu():
        return "cuda"
    if device == "cuda":
        raise UsageError("no CUDA device is available here. Use --device cpu or --device auto.")
    return "cpu"


def driver_found() -> bool:
    """Whether this machine has the driver of a GPU, working or not."""
    return _AMD_DRIVER.exists() or any(map(_loads, _DRIVERS))


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _torch_finds_a_gpu() -> bool:
    import torch

    return torch.cuda.is_available()
