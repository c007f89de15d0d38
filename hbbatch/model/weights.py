"""Weights on disk: safetensors with a JSON header, shipped by name or given by path."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from safetensors import SafetensorError, safe_open
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors
from torch import Tensor, nn

from hbbatch.errors import UsageError, WeightsError
from hbbatch.model.hybrid import HybridFilter
from hbbatch.model.kalman import KalmanFilter

WEIGHTS_VERSION: Final = 1
SHIPPED: Final = Path(__file__).parent / "weights"
DEFAULT_WEIGHTS: Final = {"hybrid": "kitti", "kalman": "kitti-kalman"}

Filter = KalmanFilter | HybridFilter


@dataclass(frozen=True)
class WeightsHeader:
    """What a weights file says of itself.

    Attributes:
        version: of the file's layout.
        filter: "hybrid" or "kalman".
        kinds: groups of road users the filter has parameters for.
        kind_of_class: class name → kind.
        options: arguments the filter is rebuilt with.
        about: licence, training data hash, training settings and metrics, for people to read.
    """

    version: int
    filter: str
    kinds: tuple[str, ...]
    kind_of_class: dict[str, str]
    options: dict[str, Any]
    about: dict[str, Any]


@dataclass(frozen=True)
class LoadedFilter:
    """A filter ready to run, and which classes it is asked to track."""

    motion: Filter
    class_names: tuple[str, ...]
    kind_codes: tuple[int, ...]
    content_hash: str
    header: WeightsHeader


def shipped_names() -> list[str]:
    """Names of the weights in the package."""
    return sorted(path.stem for path in SHIPPED.glob("*.safetensors"))


def weights_path(name: str) -> Path:
    """The file of shipped weights, or `name` itself as a path.

    Raises:
        WeightsError: neither exists.
    """
    shipped = SHIPPED / f"{name}.safetensors"
    if "/" not in name and shipped.is_file():
        return shipped
    path = Path(name)
    if path.is_file():
        return path
    raise WeightsError(
        f"weights {name!r}: neither shipped nor a file. Shipped are: {', '.join(shipped_names())}."
    )


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
    path = weights_path(name or DEFAULT_WEIGHTS[kind])
    content = path.read_bytes()
    header = read_header(path)
    if header.filter != kind:
        raise WeightsError(
            f"{path.name}: holds a {header.filter} filter, asked for {kind}. "
            f"Use --filter {header.filter} or other --weights."
        )
    class_names = _wanted(header, classes, path)
    motion = build_filter(header)
    try:
        motion.load_state_dict(load_tensors(content))
    except (RuntimeError, SafetensorError) as error:
        raise WeightsError(
            f"{path}: does not fit this version's {kind} filter ({str(error).splitlines()[0]}). "
            "Train again with `hbbatch train`."
        ) from error
    codes = tuple(header.kinds.index(header.kind_of_class[name]) for name in class_names)
    digest = hashlib.sha256(content).hexdigest()
    return LoadedFilter(motion, class_names, codes, digest, header)


def build_filter(header: WeightsHeader) -> Filter:
    """An untrained filter of the header's kind and options."""
    try:
        if header.filter == "kalman":
            return KalmanFilter(header.kinds, **header.options)
        return HybridFilter(header.kinds, **header.options)
    except TypeError as error:
        raise WeightsError(f"weights ask for unknown filter options ({error}).") from error


def read_header(path: Path) -> WeightsHeader:
    """The header of a weights file.

    Raises:
        WeightsError: no safetensors file, no header, or another version.
    """
    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
    except (OSError, SafetensorError) as error:
        raise WeightsError(f"{path}: no readable safetensors file ({error}).") from error
    try:
        fields = json.loads(metadata["hbbatch"])
        header = WeightsHeader(**{**fields, "kinds": tuple(fields["kinds"])})
    except (KeyError, TypeError, ValueError) as error:
        raise WeightsError(
            f"{path}: carries no hbbatch header. Weights are made by `hbbatch train`."
        ) from error
    if header.version != WEIGHTS_VERSION:
        raise WeightsError(
            f"{path}: weights of version {header.version}, this hbbatch reads version "
            f"{WEIGHTS_VERSION}. Use the hbbatch they came with, or train again."
        )
    return header


def weights_bytes(motion: nn.Module, header: WeightsHeader) -> bytes:
    """The content of a weights file."""
    tensors: dict[str, Tensor] = {
        name: tensor.detach().cpu().contiguous() for name, tensor in motion.state_dict().items()
    }
    return save_tensors(tensors, {"hbbatch": json.dumps(vars(header), sort_keys=True)})


def _wanted(header: WeightsHeader, classes: Sequence[str] | None, path: Path) -> tuple[str, ...]:
    if classes is None:
        return tuple(header.kind_of_class)
    unknown = [name for name in classes if name not in header.kind_of_class]
    if unknown:
        raise UsageError(
            f"class {unknown[0]!r} is unknown to the weights {path.stem}. "
            f"They know: {', '.join(header.kind_of_class)}."
        )
    return tuple(classes)
