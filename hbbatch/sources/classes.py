"""One small taxonomy for class names, whatever a detector or a data set calls them.

The name as logged is kept beside it. A name that is not in the table becomes `unknown`.
"""

from __future__ import annotations

import re
from typing import Final

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


_NORMALISED: Final = {
    _key(spelling): name for name, spellings in TAXONOMY.items() for spelling in (name, *spellings)
}


def normalise_class(name: str) -> str:
    """The taxonomy's name for a logged class name, `unknown` when it has none."""
    return _NORMALISED.get(_key(name), UNKNOWN)


def is_known_class(name: str) -> bool:
    """Whether the taxonomy has a name for a logged class name."""
    return _key(name) in _NORMALISED
