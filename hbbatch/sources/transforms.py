"""The tree of coordinate frames of a log, and the pose of a frame in the world at any time.

All transforms are read first. A moving edge is interpolated (translation linearly, rotation along
the shortest arc, as slerp does) and carried on past its first and last sample for at most
`EXTRAPOLATION_NS`; a static edge holds at all times.

The world is the ancestor of the sensor frame that is named `map`, else `odom`, `world` or `earth`,
else the root of the tree when something moves on the way to it; or the one that is asked for.
"""

from __future__ import annotations

from array import array
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hbbatch.boxes import FloatArray
from hbbatch.sources.base import IntArray
from hbbatch.sources.columns import TransformColumns

EXTRAPOLATION_NS: Final = 100_000_000
WORLD_FRAMES: Final = ("map", "odom", "world", "earth")


def frame_name(frame_id: str) -> str:
    """A frame id without the leading slash of ROS 1."""
    return frame_id.removeprefix("/")


def usable(columns: TransformColumns) -> NDArray[np.bool_]:
    """Samples whose values are all finite and whose quaternion is a rotation, `(n,)`."""
    return np.isfinite(columns.values).all(axis=1) & is_rotation(columns.values[:, 3:])


def is_rotation(quaternions: FloatArray) -> NDArray[np.bool_]:
    """Quaternions `(n, 4)` whose length is a number that can be divided by, `(n,)`."""
    with np.errstate(over="ignore", invalid="ignore"):
        square: FloatArray = (quaternions * quaternions).sum(axis=1)
    return np.isfinite(square) & (square > 0)


@dataclass(frozen=True)
class FramePoses:
    """world_from_frame at some times.

    Attributes:
        world: name of the world frame.
        translation_m: `(n, 3)`.
        rotation: `(n, 4)` unit quaternions x, y, z, w.
        exact: `(n,)` true where a sample was logged at that very time.
        known: `(n,)` false where the time is too far outside the logged ones.
    """

    world: str
    translation_m: FloatArray
    rotation: FloatArray
    exact: NDArray[np.bool_]
    known: NDArray[np.bool_]


@dataclass
class _Edge:
    """parent_from_child; static when it was never published as moving."""

    moving: bool = False
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))

    def add(self, stamps_ns: IntArray, values: FloatArray) -> None:
        self.stamps_ns.frombytes(np.ascontiguousarray(stamps_ns, dtype=np.int64).tobytes())
        self.values.frombytes(np.ascontiguousarray(values, dtype=np.float64).tobytes())

    def sorted(self) -> tuple[IntArray, FloatArray, Rotation]:
        """Stamps, translations and rotations in time order, the last said of equal stamps."""
        stamps_ns, first = np.unique(np.array(self.stamps_ns)[::-1], return_index=True)
        values = np.array(self.values).reshape(-1, 7)[::-1][first]
        return stamps_ns, values[:, :3], Rotation.from_quat(values[:, 3:])


class TransformTree:
    """Frames and the edges between them."""

    def __init__(self) -> None:
        self._parents: defaultdict[str, dict[str, _Edge]] = defaultdict(dict)

    def add(self, columns: TransformColumns, stamps_ns: IntArray, *, static: bool) -> None:
        """Take samples.

        Args:
            columns: the samples, all of them usable.
            stamps_ns: `(n,)` the times they hold at.
            static: whether they hold at all times.
        """
        pairs = columns.parents.codes * len(columns.children.vocabulary) + columns.children.codes
        order = np.argsort(pairs, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(pairs[order])) + 1):
            if len(rows):
                parent = columns.parents.vocabulary[columns.parents.codes[rows[0]]]
                child = columns.children.vocabulary[columns.children.codes[rows[0]]]
                edge = self._parents[frame_name(child)].setdefault(frame_name(parent), _Edge())
                edge.moving |= not static
                edge.add(stamps_ns[rows], columns.values[rows])

    def hang(
        self,
        child: str,
        parent: str,
        stamps_ns: IntArray,
        translation_m: FloatArray,
        rotation: FloatArray,
    ) -> None:
        """Take the pose of a frame in another at many times, joined at the child's static root.

        Static transforms may lead from the child up to a root that other sensors hang from; the
        edge is made to that root.
        """
        root = self.static_root(child)
        fixed = self.poses(child, root, stamps_ns)
        root_rotation = Rotation.from_quat(rotation) * Rotation.from_quat(fixed.rotation).inv()
        root_m = translation_m - root_rotation.apply(fixed.translation_m)
        edge = self._parents[root].setdefault(frame_name(parent), _Edge(moving=True))
        edge.add(stamps_ns, np.column_stack([root_m, root_rotation.as_quat()]))

    def static_root(self, frame: str) -> str:
        """The topmost frame that static transforms lead to from a frame."""
        root = frame_name(frame)
        for name in self._ancestors(root)[1:]:
            if self._edge(root)[1].moving:
                break
            root = name
        return root

    def static_part(self) -> TransformTree:
        """A copy that holds only the edges that never move."""
        part = TransformTree()
        for child, edges in self._parents.items():
            for parent, edge in edges.items():
                if not edge.moving:
                    part._parents[child][parent] = edge
        return part

    @property
    def moves(self) -> bool:
        """Whether any edge was published as moving."""
        return any(edge.moving for edges in self._parents.values() for edge in edges.values())

    def frames(self) -> list[str]:
        """Names of all frames, sorted."""
        return sorted({*self._parents, *(p for edges in self._parents.values() for p in edges)})

    def ambiguous(self) -> list[str]:
        """Frames that were given several parents; the one said most often counts."""
        return sorted(child for child, edges in self._parents.items() if len(edges) > 1)

    def edges(self) -> list[tuple[str, str]]:
        """Each frame with its parent, sorted; of several parents the one that counts."""
        return sorted((child, self._edge(child)[0]) for child in list(self._parents))

    def world_of(self, frame: str, asked_for: str | None = None) -> str | None:
        """The world above a frame, None when the tree has none for it."""
        ancestors = self._ancestors(frame)
        if asked_for is not None:
            return frame_name(asked_for) if frame_name(asked_for) in ancestors else None
        for world in WORLD_FRAMES:
            for name in ancestors:
                if name.rpartition("/")[2] == world:
                    return name
        path = [self._edge(child) for child in ancestors[:-1]]
        return ancestors[-1] if any(edge.moving for _, edge in path) else None

    def poses(self, frame: str, world: str, stamps_ns: IntArray) -> FramePoses:
        """world_from_frame at times; `world` is `world_of(frame)`."""
        translation_m = np.zeros((len(stamps_ns), 3))
        rotation: Rotation | None = None
        exact, known = np.ones((2, len(stamps_ns)), dtype=bool)
        while frame != world:
            frame, edge = self._edge(frame)
            edge_m, edge_rotation, edge_exact, edge_known = _at(edge, stamps_ns)
            translation_m = edge_m + edge_rotation.apply(translation_m)
            rotation = edge_rotation if rotation is None else edge_rotation * rotation
            exact &= edge_exact
            known &= edge_known
        turned = rotation or Rotation.identity(len(stamps_ns))
        return FramePoses(world, translation_m, turned.as_quat(), exact, known)

    def _edge(self, child: str) -> tuple[str, _Edge]:
        edges = self._parents[child]
        return max(edges.items(), key=lambda item: len(item[1].stamps_ns))

    def _ancestors(self, frame: str) -> list[str]:
        """A frame and what is above it, up to the root or to where a loop would close."""
        path = [frame]
        while path[-1] in self._parents:
            parent, _ = self._edge(path[-1])
            if parent in path:
                break
            path.append(parent)
        return path


def _at(
    edge: _Edge, stamps_ns: IntArray
) -> tuple[FloatArray, Rotation, NDArray[np.bool_], NDArray[np.bool_]]:
    """An edge at times: translation, rotation, whether logged then, whether known then."""
    times_ns, translations_m, rotations = edge.sorted()
    if not edge.moving:
        last = np.full(len(stamps_ns), len(times_ns) - 1)
        always = np.ones(len(stamps_ns), dtype=bool)
        return translations_m[last], rotations[last], always, always
    known = (stamps_ns >= times_ns[0] - EXTRAPOLATION_NS) & (
        stamps_ns <= times_ns[-1] + EXTRAPOLATION_NS
    )
    before = np.clip(np.searchsorted(times_ns, stamps_ns, side="right") - 1, 0, None)
    before = np.minimum(before, max(len(times_ns) - 2, 0))
    after = np.minimum(before + 1, len(times_ns) - 1)
    span_ns = np.maximum(times_ns[after] - times_ns[before], 1)
    share = np.where(after > before, (stamps_ns - times_ns[before]) / span_ns, 0.0)
    nearest = np.where(share == 1, after, before)
    moved_m, rotation = translations_m[nearest], rotations[nearest].as_quat()
    # What was logged at the very time is taken as it is.
    rows = np.flatnonzero((share != 0) & (share != 1))
    if len(rows):
        first, second, part = before[rows], after[rows], share[rows, None]
        turn = (rotations[first].inv() * rotations[second]).as_rotvec()
        rotation[rows] = (rotations[first] * Rotation.from_rotvec(part * turn)).as_quat()
        moved_m[rows] += part * (translations_m[second] - translations_m[first])
    return moved_m, Rotation.from_quat(rotation), np.isin(stamps_ns, times_ns), known
