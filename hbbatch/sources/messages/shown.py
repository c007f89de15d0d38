"""Boxes that were recorded to be shown: foxglove scenes and visualization markers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

from hbbatch.sources.messages.base import (
    NAN,
    DetectionMessage,
    Item,
    detection_message,
    stamp_ns,
    xyz,
    xyzw,
)

_SCORE_KEYS: Final = ("score", "confidence")
_CLASS_KEYS: Final = ("category", "class", "type", "label")
_ADD: Final = 0
_CUBE: Final = 1
_CUBE_LIST: Final = 6


def scene_update(message: Any) -> DetectionMessage:
    """foxglove.SceneUpdate: every cube of every entity; the stamp is that of the first entity."""
    entities = message.entities
    stamp = stamp_ns(entities[0].timestamp) if len(entities) else 0
    return detection_message(stamp, "", [item for e in entities for item in _cubes(e)])


def _cubes(entity: Any) -> Iterator[Item]:
    metadata = {pair.key.lower(): pair.value for pair in getattr(entity, "metadata", None) or ()}
    name = next((metadata[key] for key in _CLASS_KEYS if key in metadata), "")
    for cube in getattr(entity, "cubes", None) or ():
        yield Item(
            position_m=xyz(cube.pose.position),
            size_m=xyz(cube.size),
            rotation=xyzw(cube.pose.orientation),
            score=_score(metadata),
            class_name=name,
            frame_id=entity.frame_id,
        )


def _score(metadata: dict[str, str]) -> float:
    text = next((metadata[key] for key in _SCORE_KEYS if key in metadata), "")
    try:
        return float(text)
    except ValueError:
        return NAN


def marker(message: Any) -> DetectionMessage:
    """visualization_msgs/Marker: a cube or a list of cubes."""
    return _markers([message])


def marker_array(message: Any) -> DetectionMessage:
    """visualization_msgs/MarkerArray: its cubes; markers of other shapes are no boxes."""
    return _markers(message.markers)


def _markers(markers: Sequence[Any]) -> DetectionMessage:
    shown = [m for m in markers if m.action == _ADD and m.type in (_CUBE, _CUBE_LIST)]
    stamp = stamp_ns(shown[0].header.stamp) if shown else 0
    return detection_message(stamp, "", [item for m in shown for item in _marker_items(m)])


def _marker_items(shown: Any) -> Iterator[Item]:
    points = shown.points if shown.type == _CUBE_LIST else [None]
    for point in points:
        yield Item(
            position_m=_place(shown.pose, point),
            size_m=xyz(shown.scale),
            rotation=xyzw(shown.pose.orientation),
            score=NAN,
            class_name=shown.ns or shown.text,
            frame_id=shown.header.frame_id,
        )


def _place(pose: Any, point: Any) -> tuple[float, float, float]:
    """A point of a list lies in the axes of the marker's pose."""
    if point is None:
        return xyz(pose.position)
    q, (px, py, pz) = xyzw(pose.orientation), xyz(point)
    x, y, z, w = q
    square = x * x + y * y + z * z + w * w
    if not square:
        x, y, z, w, square = 0.0, 0.0, 0.0, 1.0, 1.0
    # Rotation by a quaternion of any length: p + 2 (w (v x p) + v x (v x p)) / |q|².
    ax, ay, az = y * pz - z * py, z * px - x * pz, x * py - y * px
    bx, by, bz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
    ox, oy, oz = xyz(pose.position)
    return (
        ox + px + 2 * (w * ax + bx) / square,
        oy + py + 2 * (w * ay + by) / square,
        oz + pz + 2 * (w * az + bz) / square,
    )
