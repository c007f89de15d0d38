"""Kinds of road users a filter tells apart, and which classes move like which."""

from __future__ import annotations

from typing import Final

KINDS: Final = ("vehicle", "pedestrian", "cyclist")

KIND_OF_CLASS: Final = {
    "car": "vehicle",
    "van": "vehicle",
    "truck": "vehicle",
    "bus": "vehicle",
    "trailer": "vehicle",
    "construction_vehicle": "vehicle",
    "emergency_vehicle": "vehicle",
    "vehicle": "vehicle",
    "unknown": "vehicle",
    "pedestrian": "pedestrian",
    "person_sitting": "pedestrian",
    "cyclist": "cyclist",
    "motorcyclist": "cyclist",
    "bicycle": "cyclist",
    "motorcycle": "cyclist",
}
"""Class name → kind. Detections of one kind may continue each other's tracks."""
