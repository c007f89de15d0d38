"""How a learned filter is trained, as a user may set it.

Defaults are the ones that measured best by cross-validation on the KITTI training sequences
(docs/accuracy.md); the paper's values stand in the field descriptions.
"""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from hbbatch.config import Settings


class TrainSettings(Settings):
    """How a learned filter is trained (paper, section III-F, with what measured better)."""

    measurements: Literal["detections", "labels"] = Field(
        "detections", description="what the filter is fed: detections matched to labels, or labels"
    )
    motion_model: Literal["cv", "ca", "ct"] = Field("cv", description="of the classical base")
    learn: Literal["both", "prediction", "update"] = Field(
        "prediction",
        description="which part is learned; the other stays that of the classical base. A learned "
        "update fits other sequences worse (docs/accuracy.md); the paper learns both",
    )
    learned_kinds: tuple[Literal["vehicle", "pedestrian", "cyclist"], ...] = Field(
        ("vehicle",),
        description="kinds whose motion is learned; others keep the classical base. Of few "
        "labelled ones a network remembers them and predicts others worse (docs/accuracy.md)",
    )
    frames: int = Field(20, ge=3, description="length of a tracklet")
    min_frames: int = Field(8, ge=2, description="shortest stretch of an object that is used")
    batch: int = Field(192, ge=1, description="tracklets an iteration (paper: 128)")
    iterations: int = Field(1000, ge=1, description="paper: 1,500")
    learning_rate: float = Field(2e-3, gt=0, description="peak of one cycle (paper: constant 1e-3)")
    weight_decay: float = Field(1e-4, ge=0, description="paper: 1e-5")
    state_weight: float = Field(1.0, ge=0, description="λ1")
    temporal_weight: float = Field(
        0.0, ge=0, description="λ2 (paper: 1; it rewards standing still)"
    )
    direction_weight: float = Field(0.0, ge=0, description="λ3 (paper: 1)")
    likelihood_weight: float = Field(
        0.0, ge=0, description="of the truth's likelihood under the posterior covariance"
    )
    burst_probability: float = Field(0.5, ge=0, le=1, description="tracklets with a hidden stretch")
    longest_burst: int = Field(8, ge=1, description="frames of a hidden stretch at most")
    thinned_probability: float = Field(
        0.3, ge=0, le=1, description="tracklets of which every k-th frame is kept: slower sensors"
    )
    longest_stride: int = Field(5, ge=1, description="k at most, drawn evenly from 1 on")
    noise_iterations: int = Field(150, ge=1, description="of the likelihood fit of the base")
    max_tracklets: int | None = Field(None, ge=1, description="use only so many, evenly chosen")
    seed: int = 0

    @model_validator(mode="after")
    def _likelihood_has_something_to_teach(self) -> Self:
        if self.likelihood_weight and self.learn == "prediction":
            raise ValueError(
                "likelihood_weight teaches the update, which is not learned. "
                "Add learn: both, or leave it out"
            )
        return self
