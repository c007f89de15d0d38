"""Weights files: what is refused, and that what is written is what is read."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from hbbatch.errors import UsageError, WeightsError
from hbbatch.model.hybrid import HybridFilter
from hbbatch.model.kinds import KIND_OF_CLASS, KINDS
from hbbatch.model.weights import load_filter, weights_bytes
from hbbatch.model.weights_files import WEIGHTS_VERSION, WeightsHeader, shipped_names


def header(**changes: object) -> WeightsHeader:
    fields = {
        "version": WEIGHTS_VERSION,
        "filter": "hybrid",
        "kinds": KINDS,
        "kind_of_class": KIND_OF_CLASS,
        "options": {"memory": 16},
        "about": {},
    }
    return WeightsHeader(**{**fields, **changes})  # type: ignore[arg-type]


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    torch.manual_seed(3)
    path = tmp_path / "mine.safetensors"
    path.write_bytes(weights_bytes(HybridFilter(KINDS, memory=16), header()))
    return path


def test_what_is_written_is_read_back(weights: Path) -> None:
    torch.manual_seed(3)
    expected = HybridFilter(KINDS, memory=16).state_dict()
    loaded = load_filter("hybrid", str(weights), ["van", "pedestrian"])
    state = loaded.motion.state_dict()
    assert all(torch.equal(expected[name], state[name]) for name in expected)
    assert loaded.class_names == ("van", "pedestrian")
    assert [KINDS[code] for code in loaded.kind_codes] == ["vehicle", "pedestrian"]


def test_another_filter_or_class_or_name_is_refused(weights: Path) -> None:
    with pytest.raises(WeightsError, match="Use --filter hybrid"):
        load_filter("kalman", str(weights), None)
    with pytest.raises(UsageError, match="class 'ufo' is unknown"):
        load_filter("hybrid", str(weights), ["ufo"])
    with pytest.raises(WeightsError, match="neither shipped nor a file"):
        load_filter("hybrid", "no-such-weights", None)


def test_another_version_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "new.safetensors"
    path.write_bytes(weights_bytes(HybridFilter(KINDS), header(version=99)))
    with pytest.raises(WeightsError, match=r"new\.safetensors: weights of version 99"):
        load_filter("hybrid", str(path), None)


def test_tensors_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.safetensors"
    path.write_bytes(weights_bytes(HybridFilter(KINDS, memory=8), header()))
    with pytest.raises(WeightsError, match="does not fit"):
        load_filter("hybrid", str(path), None)


@pytest.mark.parametrize("content", [b"", b"not weights", pickle.dumps({"a": 1})])
def test_damaged_and_pickled_files_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.safetensors"
    path.write_bytes(content)
    with pytest.raises(WeightsError, match=r"bad\.safetensors: no readable safetensors"):
        load_filter("hybrid", str(path), None)


def test_foreign_safetensors_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "foreign.safetensors"
    save_file({"a": torch.zeros(1)}, path, metadata={"hbbatch": json.dumps({"x": 1})})
    with pytest.raises(WeightsError, match="carries no hbbatch header"):
        load_filter("hybrid", str(path), None)


def test_shipped_weights_load_and_say_their_licence() -> None:
    for name in shipped_names():
        kind = "kalman" if name.endswith("kalman") else "hybrid"
        assert load_filter(kind, name, None).header.about["licence"]
