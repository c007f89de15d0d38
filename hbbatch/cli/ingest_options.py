"""What `ingest` and `info` may be told about sources."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from hbbatch.sources.base import SourceOptions

SourceArgument = Annotated[
    # One that cannot be read is reported like any other that fails, and stops none of them.
    list[Path],
    typer.Argument(help="Logs, or folders of them.", readable=False),
]
DetectionsOption = Annotated[
    Path | None,
    typer.Option(
        help="Folder of detection files, for KITTI. Default: det_02 or detections in SOURCE."
    ),
]
TopicOption = Annotated[
    list[str] | None, typer.Option(help="Detection topic of a log; may be repeated.")
]
WorldFrameOption = Annotated[
    str | None,
    typer.Option(help="World frame of a log. Default: map, odom, world, earth or the tree's root."),
]
PoseTopicOption = Annotated[
    str | None, typer.Option(help="Take ego poses from this topic of a log only.")
]
MaxGapOption = Annotated[
    float | None,
    typer.Option(
        min=0.001,
        help="Seconds without a frame that start a new sequence. Default: what a track survives.",
    ),
]
MappingOption = Annotated[
    list[Path] | None,
    typer.Option(help="YAML that says where boxes are in message types of your own."),
]
MessagePathOption = Annotated[
    list[Path] | None,
    typer.Option("--msg-path", help="Folder of .msg files, for logs without definitions."),
]
DistroOption = Annotated[
    str | None,
    typer.Option(
        "--ros-distro", help="ROS 2 release, for logs without definitions. Default: humble."
    ),
]
ClassesOption = Annotated[
    Path | None, typer.Option(help="YAML that extends the table of class names.")
]


def source_options(
    detections: Path | None,
    topic: list[str] | None,
    world_frame: str | None,
    pose_topic: str | None,
    max_gap_s: float | None,
    mapping: list[Path] | None,
    msg_path: list[Path] | None,
    ros_distro: str | None,
    classes: Path | None,
) -> SourceOptions:
    """The options together, relative paths as given."""
    from hbbatch.sources.base import SourceOptions

    return SourceOptions(
        detections=detections,
        topics=tuple(topic or ()),
        world_frame=world_frame,
        pose_topic=pose_topic,
        max_gap_s=max_gap_s,
        mappings=tuple(mapping or ()),
        message_paths=tuple(msg_path or ()),
        ros_distro=ros_distro,
        classes=classes,
    )
