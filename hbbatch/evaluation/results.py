"""What an evaluation gives back."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

Protocol = Literal["kitti_2d", "box_3d"]
"""`kitti_2d`: KITTI's official protocol on image boxes. `box_3d`: rotated boxes in the sensor
frame, for datasets without a camera."""


@dataclass(frozen=True)
class Scores:
    """Metrics of one class, on one sequence or on several together.

    The measures are percentages as the KITTI benchmark prints them; HOTA and its parts are means
    over the localisation thresholds 0.05 to 0.95, the CLEAR and identity measures use 0.5. On a
    sequence without labels and tracks of the class they are what TrackEval defines, mostly zero.

    Attributes:
        hota, deta, assa, loca: Luiten et al., IJCV 2021.
        mota, idsw, frag, fp, fn: Bernardin and Stiefelhagen, 2008 (CLEAR); the last four count.
        idf1: Ristani et al., 2016.
        labelled_boxes, labelled_objects: what there was to find, ignored labels not counted.
        tracked_boxes, tracks: what was said, boxes in ignored regions not counted.
    """

    hota: float
    deta: float
    assa: float
    loca: float
    mota: float
    idf1: float
    idsw: int
    frag: int
    fp: int
    fn: int
    labelled_boxes: int
    labelled_objects: int
    tracked_boxes: int
    tracks: int


@dataclass(frozen=True)
class ClassScores:
    """Scores of one class: all sequences together, and each alone, by sequence id."""

    combined: Scores
    sequences: dict[str, Scores]


@dataclass(frozen=True)
class Evaluation:
    """Scores by class name, and the protocol they were measured with."""

    protocol: Protocol
    classes: dict[str, ClassScores]

    def to_json(self) -> dict[str, Any]:
        """The same as plain values."""
        return asdict(self)
