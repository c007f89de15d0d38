"""Where to compute."""

from __future__ import annotations

import pytest
import torch

from hbbatch.errors import UsageError
from hbbatch.runner import device as device_module
from hbbatch.runner.device import resolved_device


def machine(monkeypatch: pytest.MonkeyPatch, *, driver: bool, gpu: bool) -> None:
    monkeypatch.setattr(device_module, "driver_found", lambda: driver)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: gpu)


def test_auto_is_the_gpu_where_there_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    machine(monkeypatch, driver=True, gpu=True)
    assert resolved_device("auto") == "cuda"
    assert resolved_device("cuda") == "cuda"
    assert resolved_device("cpu") == "cpu"


def test_a_driver_without_a_gpu_is_no_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    machine(monkeypatch, driver=True, gpu=False)
    assert resolved_device("auto") == "cpu"
    with pytest.raises(UsageError, match="no CUDA device"):
        resolved_device("cuda")


def test_torch_is_not_asked_where_there_is_no_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    machine(monkeypatch, driver=False, gpu=True)
    assert resolved_device("auto") == "cpu"
    with pytest.raises(UsageError, match="no CUDA device"):
        resolved_device("cuda")


def test_a_driver_is_a_library_that_loads(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def load(library: str) -> None:
        asked.append(library)
        if library != "libcuda.so.1":
            raise OSError(library)

    monkeypatch.setattr(device_module, "_AMD_DRIVER", device_module.Path("/nosuch"))
    monkeypatch.setattr(device_module.ctypes, "CDLL", load)
    assert device_module.driver_found()
    assert asked == ["libcuda.so.1"]
