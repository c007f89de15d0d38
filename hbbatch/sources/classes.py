"""One small taxonomy for class names, whatever a detector or a data set calls them.

The name as logged is kept beside it. A name that is not in the table becomes `unknown`; a YAML file
can extend the table.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from hbbatch.config import Settings, validate

UNKNOWN: Final = "unknown"
DONT_CARE: Final = "dont_care"

TAXONOMY: Final[dict[str, tuple[str, ...]]] = {
    "car": ("automobile", "sedan", "passenger_car", "vehicle_car"),
    "van": ("minivan",),
    "truck": ("lorry", "pickup_truck", "heavy_truck"),
    "bus": ("coach", "school_bus"),
    "trailer": ("semi_trailer",),
    "construction_vehicle": ("excavator",),
    "emergency_vehicle": ("ambulance", "fire_truck", "police_car"),
    "vehicle": ("other_vehicle", "motor_vehicle"),
    "tram": ("train", "streetcar"),
    "motorcycle": ("motorbike", "scooter"),
    "motorcyclist": (),
    "bicycle": ("bike",),
    "cyclist": ("bicyclist", "rider"),
    "pedestrian": ("person", "human", "people"),
    "person_sitting": (),
    "animal": (),
    "barrier": (),
    "traffic_cone": ("cone",),
    "traffic_sign": ("sign",),
    "hazard": (),
    "misc": ("other",),
    DONT_CARE: ("ignore",),
    UNKNOWN: ("", "unclassified", "undefined", "none"),
}
"""Normalised name to the other spellings it is known by; case and separators do not matter."""


def _key(name: str) -> str:
    """Lower case without separators: `Person_sitting`, `person sitting` and `PersonSitting`."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


class Taxonomy:
    """The table, with what a user adds to it."""

    def __init__(self, additions: Mapping[str, Sequence[str]] | None = None) -> None:
        """Additions are names with their other spellings; they win over the table."""
        tables = (TAXONOMY, additions or {})
        self._names = {
            _key(spelling): name
            for table in tables
            for name, spellings in table.items()
            for spelling in (name, *spellings)
        }

    def normalise(self, name: str) -> str:
        """The taxonomy's name for a logged class name, `unknown` when it has none."""
        return self._names.get(_key(name), UNKNOWN)

    def knows(self, name: str) -> bool:
        """Whether the taxonomy has a name for a logged class name."""
        return _key(name) in self._names


_TABLE: Final = Taxonomy()


class _ClassesFile(Settings):
    classes: dict[str, tuple[str, ...]]


def load_taxonomy(path: Path | None) -> Taxonomy:
    """The table, extended by a YAML file: `classes:` with names and lists of their spellings.

    Raises:
        ConfigError: the file cannot be read or does not validate.
    """
    if path is None:
        return _TABLE
    from hbbatch.yaml_files import load_yaml

    return Taxonomy(validate(_ClassesFile, load_yaml(path), str(path)).classes)


def normalise_class(name: str) -> str:
    """The table's name for a logged class name, `unknown` when it has none."""
    return _TABLE.normalise(name)


def is_known_class(name: str) -> bool:
    """Whether the table has a name for a logged class name."""
    return _TABLE.knows(name)
