"""Frozen settings of a tracking run; the resolved copy is saved with every run.

Defaults are the ones that measured best by cross-validation on the KITTI training sequences
(docs/accuracy.md); the paper's values stand in the field descriptions.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any, Final, Literal, Self, TypeVar, cast, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from hbbatch.errors import ConfigError

_Model = TypeVar("_Model", bound=BaseModel)
CostName = Literal["ciou_3d", "l2", "l2_size", "ciou_2d"]
FilterName = Literal["hybrid", "kalman"]
DeviceName = Literal["auto", "cpu", "cuda"]

_MAX_COST: dict[CostName, float] = {"ciou_3d": 1.2, "l2": 4.0, "l2_size": 6.0, "ciou_2d": 1.2}


class Settings(BaseModel):
    """Base of all settings: immutable, unknown keys and numbers that are not finite are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class AssociationSettings(Settings):
    """Greedy one-stage association (paper, section III-C)."""

    cost: CostName = Field("ciou_3d", description="what a pair of prior and detection costs")
    max_cost: float | None = Field(
        None, gt=0, description="pairs at or above are never matched; default by cost (paper: 1.2)"
    )

    @property
    def threshold(self) -> float:
        """The cost at and above which a pair is never matched."""
        return _MAX_COST[self.cost] if self.max_cost is None else self.max_cost


class ManagementSettings(Settings):
    """When tracks begin and end (paper, section III-E)."""

    max_misses: int = Field(
        22, ge=1, le=1_000_000, description="a track dies after so many misses (μ_max)"
    )
    max_misses_unconfirmed: int = Field(
        5,
        ge=1,
        le=1_000_000,
        description="a track never matched after its birth dies after so many steps (σ)",
    )


class DampingSettings(Settings):
    """The dynamic scaling factor α of the residual (paper, section III-B)."""

    enabled: bool = Field(False, description="off by default: it costs accuracy (docs/accuracy.md)")
    ramp_frames: int = Field(8, ge=1, description="T_max: frames until a young track moves fully")
    minimum: float = Field(0.1, ge=0, le=1, description="a_min")
    maximum: float = Field(0.9, ge=0, le=1, description="a_max")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.minimum > self.maximum:
            raise ValueError("minimum must not exceed maximum")
        return self


ProtocolName = Literal["online", "gap_filled"]

ScoreCut = float | dict[str, float] | None
"""A lowest score for all classes, one a class (absent: no cut), or none."""


NEARLY_SURE: Final = (1e-3, 0.999)
"""Scores that are probabilities count as no closer to 0 and 1 than this, where logits run away."""


class ScoreScale(Settings):
    """Where a detector's scores of true objects lie; `hbbatch calibrate` finds it."""

    typical: float = Field(description="median score on tracks that persist")
    strong: float = Field(description="80 % quantile of the same")
    probability: bool = Field(False, description="scores are probabilities: compared as logits")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.typical < self.strong:
            raise ValueError("strong must exceed typical")
        low, high = NEARLY_SURE
        if self.probability and not (0.0 <= self.typical < high and low < self.strong <= 1.0):
            raise ValueError(f"probabilities lie in 0..1, typical below {high}, strong above {low}")
        return self


class ConfidenceWeights(Settings):
    """Logistic weights of what speaks for a box (`hbbatch.tracking.confidence`).

    Scores count on the detector's scale: 0 is typical, 1 strong.
    """

    bias: float
    detection_score: float = Field(description="of the box's own detection")
    nearby_score: float = Field(description="mean score of the track, frames nearby")
    track_score: float = Field(description="mean score of the track (online: so far)")
    presence: float = Field(description="share of the frames nearby that hold a detection")
    detections: float = Field(description="log of the track's detections (online: so far)")
    range: float = Field(description="distance from the sensor in units of 50 m")
    unseen: float = Field(description="seconds to the nearest detection (online: since the last)")

    def in_order(self) -> list[float]:
        """The weights in the order of the fields."""
        return list(self.model_dump().values())

    @classmethod
    def from_order(cls, values: Sequence[float]) -> Self:
        """Weights in the order of the fields."""
        return cls.model_validate(dict(zip(cls.model_fields, values, strict=True)))


class KindConfidence(Settings):
    """What makes boxes of one kind of road user likely right, with and without a detection."""

    detected: ConfidenceWeights
    undetected: ConfidenceWeights | None = Field(
        None, description="without: predictions are not written, interpolated boxes unjudged"
    )

    @model_validator(mode="before")
    @classmethod
    def _not_of_old(cls, given: Any) -> Any:
        if isinstance(given, dict) and given.keys() & ConfidenceWeights.model_fields.keys():
            raise ValueError(
                "weights are given for detected and undetected boxes apart. "
                "Make the file again with hbbatch calibrate --from-labels"
            )
        return given


class OutputSettings(Settings):
    """Which boxes of a track are written.

    `online` is causal: a box is final when its frame is processed; coasted boxes are marked.
    `gap_filled` is the published protocol: gaps are interpolated, predictions after the last
    detection are cut. On top of it, boxes are smoothed with what came before and after them, and
    tracks begin up to `lead_in_s` before their first detection.
    """

    protocol: ProtocolName = "gap_filled"
    score_scale: dict[str, ScoreScale] = Field(
        {}, description="scale of the detector's scores, by class; without, nothing is judged"
    )
    confidence: dict[ProtocolName, dict[str, KindConfidence]] = Field(
        {},
        description="what makes a box likely right, by protocol and kind; "
        "those not named: as shipped",
    )
    min_confidence: float = Field(
        0.5,
        ge=0,
        le=1,
        description="boxes judged less likely to be right are not written; "
        "0: all are, predictions included",
    )
    min_track_score: ScoreCut = Field(
        None, description="boxes of tracks whose mean detection score is lower are not written"
    )
    min_detections: int = Field(
        1, ge=1, description="boxes of tracks with fewer detections are not written"
    )
    max_coasted: int = Field(
        5,
        ge=0,
        description="online: predictions said after so many misses in a row at most, "
        "those judged likely right",
    )
    smoothing_s: float = Field(
        1.5,
        ge=0,
        description="gap_filled: how far away in time detections may be that centres and headings "
        "are smoothed with; 0: these stay as the filter has them",
    )
    lead_in_s: float = Field(
        1.0,
        ge=0,
        description="gap_filled: how far tracks are continued to before their first detection "
        "at most, as far as judged likely right",
    )

    @property
    def judges(self) -> bool:
        """Whether anything is known by which weak boxes are left out."""
        return bool(self.score_scale) or self.min_track_score is not None


class TrackSettings(Settings):
    """Everything that decides the tracks of a run, but not how fast they come."""

    filter: FilterName = "hybrid"
    weights: str | None = Field(
        None, description="shipped name or path of a .safetensors; default by filter"
    )
    classes: tuple[str, ...] | None = Field(
        None, min_length=1, description="default: all the weights know"
    )
    min_score: float | None = Field(None, description="detections scored lower are ignored")
    association: AssociationSettings = AssociationSettings()
    management: ManagementSettings = ManagementSettings()
    damping: DampingSettings = DampingSettings()
    output: OutputSettings = OutputSettings()

    def digest(self) -> str:
        """Short hash of all values, equal for equal settings."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()[:8]


def validate(model: type[_Model], content: dict[str, Any], what: str) -> _Model:
    """A settings object from plain data.

    Raises:
        ConfigError: one line naming every offending key.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        faults = "; ".join(
            f"{'.'.join(map(str, fault['loc'])) or 'top level'}: {_fault(model, fault)}"
            for fault in error.errors()
        )
        raise ConfigError(f"{what}: {faults}.") from error


def _fault(model: type[BaseModel], fault: ErrorDetails) -> str:
    if fault["type"] != "extra_forbidden":
        return fault["msg"].removeprefix("Value error, ")
    known = _settings_at(model, fault["loc"][:-1]).model_fields
    names = [field.alias or name for name, field in known.items()]
    return f"unknown setting; known are {', '.join(names)}"


def _settings_at(model: type[BaseModel], location: Sequence[int | str]) -> type[BaseModel]:
    """The settings nested in others at a location: fields, keys of mappings, places in lists."""
    annotation: Any = model
    for part in location:
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            annotation = annotation.model_fields[str(part)].annotation
        else:
            annotation = [kind for kind in get_args(annotation) if kind is not Ellipsis][-1]
    return cast("type[BaseModel]", annotation)
