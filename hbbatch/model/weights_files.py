"""Weights on disk: safetensors with a JSON header, shipped by name or given by path.

No torch here: whether weights are there, fit and have changed is known before anything heavy loads.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import load as load_arrays

from hbbatch.errors import UsageError, WeightsError
from hbbatch.motion.parameters import Parameters

WEIGHTS_VERSION: Final = 2
SHIPPED: Final = Path(__file__).parent / "weights"
DEFAULT_WEIGHTS: Final = {"hybrid": "kitti", "kalman": "kitti-kalman"}


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
class WeightsFile:
    """A weights file found fit for what is asked of it.

    Attributes:
        path: where it lies.
        content: its bytes.
        header: what it says of itself.
        class_names: the classes it is asked to track.
    """

    path: Path
    content: bytes
    header: WeightsHeader
    class_names: tuple[str, ...]

    @property
    def content_hash(self) -> str:
        """Hash of the whole file."""
        return hashlib.sha256(self.content).hexdigest()

    @property
    def kind_codes(self) -> tuple[int, ...]:
        """For each class, which of the header's kinds it is."""
        kinds, kind_of_class = self.header.kinds, self.header.kind_of_class
        return tuple(kinds.index(kind_of_class[name]) for name in self.class_names)

    def parameters(self) -> Parameters:
        """The filter's arrays, by name.

        Raises:
            WeightsError: the file is damaged.
        """
        try:
            arrays = load_arrays(self.content)
        except (SafetensorError, KeyError) as error:
            raise self.misfit(str(error)) from error
        return {name: array.astype(np.float32, copy=False) for name, array in arrays.items()}

    def misfit(self, reason: str) -> WeightsError:
        """That the file's arrays are not those of this version's filter."""
        return WeightsError(
            f"{self.path}: does not fit this version's {self.header.filter} filter ({reason}). "
            "Train again with `hbbatch train`."
        )


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


def open_weights(kind: str, name: str | None, classes: Sequence[str] | None) -> WeightsFile:
    """The weights file of a filter, checked but for its tensors.

    Args:
        kind: "hybrid" or "kalman".
        name: shipped name or path; None for the default of the kind.
        classes: classes to track; None for all the weights know.

    Raises:
        WeightsError: the file is missing, damaged, of another version or of another kind.
        UsageError: a class the weights do not know.
    """
    path = weights_path(name or DEFAULT_WEIGHTS[kind])
    header = read_header(path)
    if header.filter != kind:
        raise WeightsError(
            f"{path.name}: holds a {header.filter} filter, asked for {kind}. "
            f"Use --filter {header.filter} or other --weights."
        )
    return WeightsFile(path, path.read_bytes(), header, _wanted(header, classes, path))


def read_header(path: Path) -> WeightsHeader:
    """The header of a weights file.

    Raises:
        WeightsError: no safetensors file, no header, or another version.
    """
    try:
        with safe_open(path, "np") as file:
            metadata = file.metadata() or {}
    except (OSError, SafetensorError) as error:
        raise WeightsError(f"{path}: no readable safetensors file ({error}).") from error
    try:
        fields = json.loads(metadata["hbbatch"])
        _check_version(path, int(fields["version"]))
        return WeightsHeader(**{**fields, "kinds": tuple(fields["kinds"])})
    except (KeyError, TypeError, ValueError) as error:
        raise WeightsError(
            f"{path}: carries no hbbatch header. Weights are made by `hbbatch train`."
        ) from error


def _check_version(path: Path, version: int) -> None:
    if version != WEIGHTS_VERSION:
        raise WeightsError(
            f"{path}: weights of version {version}, this hbbatch reads version "
            f"{WEIGHTS_VERSION}. Use the hbbatch they came with, or train again."
        )


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
