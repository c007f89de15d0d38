"""Message types of one's own: a YAML file says where in them the boxes are.

An entry a type:

    messages:
      - type: my_msgs/msg/Objects
        objects: items                    # path to the list
        time: header.stamp
        frame: header.frame_id
        centre: pose.position             # something with x, y, z, or three paths
        size: [length, width, height]     # the same
        orientation: pose.orientation     # a quaternion with x, y, z, w; or yaw: path, in radians
        score: confidence                 # optional
        class: label                      # optional
        classes: {0: car, 1: pedestrian}  # optional: what the values of `class` mean

Paths are relative to the message for `objects`, `time` and `frame`, else to an object of the list.
A number in a path is an element of a list, from 0: `hypotheses.0.score`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cache, reduce
from pathlib import Path
from typing import Any, Self

from pydantic import Field, model_validator

from hbbatch.config import Settings, validate
from hbbatch.sources.messages import DETECTION_MESSAGES, ReadDetections, normalise_type
from hbbatch.sources.messages.base import (
    NAN,
    NO_ROTATION,
    DetectionMessage,
    Item,
    detection_message,
    stamp_ns,
    xyz,
    xyzw,
)
from hbbatch.yaml_files import load_yaml

_Three = str | tuple[str, str, str]


class MessageMapping(Settings):
    """Where the boxes of one message type are."""

    type: str = Field(description="message type, as package/msg/Type")
    objects: str = Field(description="path to the list of objects")
    time: str = Field("header.stamp", description="path to the stamp")
    frame: str = Field("header.frame_id", description="path to the name of the frame")
    centre: _Three = Field(description="path to x, y, z, or three paths")
    size: _Three = Field(description="path to x, y, z (length, width, height), or three paths")
    orientation: str | None = Field(None, description="path to a quaternion")
    yaw: str | None = Field(None, description="path to a yaw in radians, instead of orientation")
    score: str | None = Field(None, description="path to the score")
    class_path: str | None = Field(None, alias="class", description="path to the class")
    classes: dict[str | int, str] = Field({}, description="value of the class to its name")

    @model_validator(mode="after")
    def _one_heading(self) -> Self:
        if (self.orientation is None) == (self.yaw is None):
            raise ValueError("give either orientation or yaw")
        return self

    def read(self, message: Any) -> DetectionMessage:
        """The boxes of a decoded message."""
        items = [self._item(thing) for thing in _follow(message, self.objects)]
        stamp = stamp_ns(_follow(message, self.time))
        return detection_message(stamp, str(_follow(message, self.frame)), items)

    def _item(self, thing: Any) -> Item:
        turned = self.orientation
        return Item(
            position_m=_three(thing, self.centre),
            size_m=_three(thing, self.size),
            rotation=NO_ROTATION if turned is None else xyzw(_follow(thing, turned)),
            score=float(_if_there(thing, self.score, NAN)),
            class_name=self._class_name(thing),
            yaw=None if self.yaw is None else float(_follow(thing, self.yaw)),
        )

    def _class_name(self, thing: Any) -> str:
        value = _if_there(thing, self.class_path, "")
        key = value if isinstance(value, str) else int(value)
        return self.classes.get(key, str(key))


class MappingFile(Settings):
    """A mapping file."""

    messages: tuple[MessageMapping, ...] = Field(min_length=1)


def _follow(message: Any, path: str) -> Any:
    """What lies at a path.

    Raises:
        AttributeError: a field of the path is not there.
        IndexError: a list of the path is too short.
    """
    try:
        return reduce(_part, path.split("."), message)
    except AttributeError as error:
        raise AttributeError(f"no field {path}, which the mapping file names") from error


def _part(thing: Any, name: str) -> Any:
    return thing[int(name)] if name.isdecimal() else getattr(thing, name)


def _if_there(thing: Any, path: str | None, otherwise: Any) -> Any:
    """What lies at an optional path; lists on the way may be empty."""
    try:
        return otherwise if path is None else _follow(thing, path)
    except IndexError:
        return otherwise


def _three(thing: Any, paths: _Three) -> tuple[float, float, float]:
    if isinstance(paths, str):
        return xyz(_follow(thing, paths))
    first, second, third = (float(_follow(thing, path)) for path in paths)
    return first, second, third


@cache
def detection_messages(mappings: tuple[Path, ...]) -> dict[str, ReadDetections]:
    """Types that hold detected boxes: those hbbatch knows, and those of mapping files.

    Raises:
        ConfigError: a mapping file cannot be read or does not validate.
    """
    known = dict(DETECTION_MESSAGES)
    for path in mappings:
        for mapping in validate(MappingFile, load_yaml(path), str(path)).messages:
            known[normalise_type(mapping.type)] = mapping.read
    return known


def mapping_hashes(mappings: Sequence[Path]) -> list[str]:
    """Hashes of the contents of mapping files."""
    return [hashlib.sha256(path.read_bytes()).hexdigest() for path in mappings]
