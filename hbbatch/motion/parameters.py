"""What a filter is made from: its options, and the arrays that come with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hbbatch.motion.columns import MotionModel, kalman_order
from hbbatch.motion.constants import AXES, HEADS

Parameters = Mapping[str, NDArray[np.float32]]
"""Arrays by the names that the torch modules give them."""

Shapes = dict[str, tuple[int, ...]]


@dataclass(frozen=True)
class KalmanOptions:
    """Of the classical filter; `model.kalman.KalmanFilter` takes the same."""

    model: MotionModel = "cv"

    def shapes(self, kinds: int) -> Shapes:
        """Shape of each parameter."""
        return {
            "log_r": (kinds, AXES),
            "log_r_range": (kinds, AXES),
            "log_q": (kinds, AXES),
            "log_initial": (kinds, kalman_order(self.model) - 1, AXES),
            "log_r_size": (kinds, 3),
            "log_q_size": (kinds, 3),
        }


@dataclass(frozen=True)
class HybridOptions:
    """Of the learned filter; `model.hybrid.HybridFilter` takes the same and says what they mean."""

    motion_model: MotionModel = "ct"
    history: int = 4
    memory: int = 64
    hidden: int = 64
    head: int = 32
    learned: Sequence[bool] = ()

    def learned_kinds(self, kinds: int) -> list[float]:
        """One for each kind whose motion is learned, else zero: the classical base alone.

        Raises:
            TypeError: there is not one entry a kind.
        """
        chosen = [float(learned) for learned in self.learned] or [1.0] * kinds
        if len(chosen) != kinds:
            raise TypeError(f"learned has {len(chosen)} entries for {kinds} kinds")
        return chosen

    def shapes(self, kinds: int) -> Shapes:
        """Shape of each parameter."""
        base = KalmanOptions(self.motion_model).shapes(kinds)
        return {
            **{f"base.{name}": shape for name, shape in base.items()},
            **_linear("residual.encoder", self.predict_features(kinds), self.hidden),
            **_linear("residual.heads_in", self.hidden, self.head * len(HEADS)),
            **{
                name: shape
                for head, axes in HEADS.items()
                for name, shape in _linear(
                    f"residual.heads_out.{head}", self.head, len(axes)
                ).items()
            },
            "gain.recurrent.weight_ih": (3 * self.memory, update_features(kinds)),
            "gain.recurrent.weight_hh": (3 * self.memory, self.memory),
            "gain.recurrent.bias_ih": (3 * self.memory,),
            "gain.recurrent.bias_hh": (3 * self.memory,),
            **_linear("gain.read_out", self.memory, 2 * AXES),
        }

    def predict_features(self, kinds: int) -> int:
        """What the residual predictor sees: memory, history, correction, velocity, times, size."""
        return self.memory + 7 * self.history + 7 + AXES + 2 + 1 + 3 + kinds


def update_features(kinds: int) -> int:
    """What the gain network sees: innovation, correction, spread, times, where from, size."""
    return 7 + 7 + AXES + 2 + 2 + 2 + 3 + kinds


def _linear(name: str, inputs: int, outputs: int) -> Shapes:
    return {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}


def misfit(parameters: Parameters, shapes: Shapes) -> str | None:
    """What is wrong with parameters, None where they have the shapes that are asked for."""
    missing = sorted(shapes.keys() - parameters.keys())
    if missing:
        return f"{missing[0]} is missing"
    unknown = sorted(parameters.keys() - shapes.keys())
    if unknown:
        return f"{unknown[0]} is unknown"
    for name, shape in shapes.items():
        if parameters[name].shape != shape:
            return f"{name} has shape {parameters[name].shape}, not {shape}"
    return None


def part(parameters: Parameters, name: str) -> dict[str, Any]:
    """The parameters of a part, by the names they have in it."""
    start = f"{name}."
    return {
        whole.removeprefix(start): array
        for whole, array in parameters.items()
        if whole.startswith(start)
    }
