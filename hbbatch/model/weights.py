"""Filters made from weights files, and written to them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors
from torch import Tensor, nn

from hbbatch.errors import WeightsError
from hbbatch.model.hybrid import HybridFilter
from hbbatch.model.kalman import KalmanFilter
from hbbatch.model.weights_files import WeightsFile, WeightsHeader, open_weights

Filter = KalmanFilter | HybridFilter


@dataclass(frozen=True)
class LoadedFilter:
    """A filter ready to run, and which classes it is asked to track."""

    motion: Filter
    class_names: tuple[str, ...]
    kind_codes: tuple[int, ...]
    content_hash: str
    header: WeightsHeader


def load_filter(kind: str, name: str | None, classes: Sequence[str] | None) -> LoadedFilter:
    """The filter of a weights file.

    Args:
        kind: "hybrid" or "kalman".
        name: shipped name or path; None for the default of the kind.
        classes: classes to track; None for all the weights know.

    Raises:
        WeightsError: the file is missing, damaged, of another version or of another kind.
        UsageError: a class the weights do not know.
    """
    file = open_weights(kind, name, classes)
    motion = build_loaded(file)
    return LoadedFilter(motion, file.class_names, file.kind_codes, file.content_hash, file.header)


def build_loaded(file: WeightsFile) -> Filter:
    """The filter of a weights file.

    Raises:
        WeightsError: the file does not fit this version's filters.
    """
    motion = build_filter(file.header)
    try:
        motion.load_state_dict(load_tensors(file.content))
    except (RuntimeError, SafetensorError) as error:
        raise file.misfit(str(error).splitlines()[0]) from error
    return motion


def build_filter(header: WeightsHeader) -> Filter:
    """An untrained filter of the header's kind and options."""
    try:
        if header.filter == "kalman":
            return KalmanFilter(header.kinds, **header.options)
        return HybridFilter(header.kinds, **header.options)
    except TypeError as error:
        raise WeightsError(f"weights ask for unknown filter options ({error}).") from error


def weights_bytes(motion: nn.Module, header: WeightsHeader) -> bytes:
    """The content of a weights file."""
    tensors: dict[str, Tensor] = {
        name: tensor.detach().cpu().contiguous() for name, tensor in motion.state_dict().items()
    }
    return save_tensors(tensors, {"hbbatch": json.dumps(vars(header), sort_keys=True)})
