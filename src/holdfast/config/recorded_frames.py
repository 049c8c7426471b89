"""What a recording tells of frames: where things sit, which frame a topic measures in, and what turns."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from holdfast.config.frame_tree import Link, links_from
from holdfast.messages import Array

FIXED_TO_EARTH = ("map", "odom", "world", "earth", "utm", "global", "local_enu", "navsat", "start", "init")


class RecordedLink(NamedTuple):
    """A rigid transform T_parent_child (4, 4) [m] that a recording holds, and the topic that told it."""

    parent: str
    child: str
    T: Array
    source: str


class Joined(NamedTuple):
    """The pose T_origin_frame (4, 4) [m] of a frame, and where it comes from, in words."""

    T: Array
    source: str


@dataclass(frozen=True)
class RecordedFrames:
    """What a recording tells of frames.

    Attributes:
        links: rigid transforms, none of which contradicts another.
        turning: the poses of frames that follow the angle of a joint, where that reads zero.
        of_topic: topic -> the frame in which its messages measure.
        joints: topic -> names of the joints in its messages.
        warnings: what contradicts itself, one line each.
    """

    links: tuple[RecordedLink, ...] = ()
    turning: tuple[RecordedLink, ...] = ()
    of_topic: Mapping[str, str] = field(default_factory=dict)
    joints: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def knows(self, frame: str) -> bool:
        """Whether a frame is in the tree."""
        return any(frame in (link.parent, link.child) for link in (*self.links, *self.turning))

    def root(self, frame: str) -> str:
        """Return the frame that has no parent among those that are rigidly joined to a frame."""
        parents = {link.child: link.parent for link in self.links}
        while frame in parents:
            frame = parents[frame]
        return frame

    def joined(self, origin: str) -> dict[str, Joined]:
        """Return all frames that are rigidly joined to one, itself not included."""
        sources = {frozenset(link[:2]): link.source for link in self.links}
        found: dict[str, tuple[Array, tuple[str, ...]]] = {origin: (np.eye(4), (origin,))}
        for parent, child, T in links_from(origin, [Link(*link[:3]) for link in self.links]):
            pose, path = found[parent]
            found[child] = pose @ T, (*path, child)
        del found[origin]
        return {frame: Joined(T, _words(path, sources)) for frame, (T, path) in found.items()}


def is_fixed_to_earth(frame: str) -> bool:
    """Whether a frame is one, by its name, in which machines move, such as `odom`."""
    name = frame.lower().rpartition("/")[2]
    return any(name == word or name.startswith(f"{word}_") or name.endswith(f"_{word}") for word in FIXED_TO_EARTH)


def faultless(links: list[RecordedLink]) -> tuple[list[RecordedLink], list[str]]:
    """Return those transforms that contradict none, and what was wrong with the others, one line each."""
    good, warnings = [], []
    for child in dict.fromkeys(link.child for link in links):
        of_child = [link for link in links if link.child == child]
        parents = list(dict.fromkeys(link.parent for link in of_child))
        topics = " and ".join(dict.fromkeys(link.source for link in of_child))
        if len(parents) > 1:
            named = " and ".join(map(repr, parents))
            warnings.append(f"{topics}: frame {child!r} has the parents {named}: it is used below none of them")
        elif (apart := _apart(of_child)) is not None:
            warnings.append(f"{topics}: {child!r} in {parents[0]!r} is given twice, {apart}: it is not used")
        else:
            good.append(of_child[0])
    circling = set(_circling(good))
    if circling:
        warnings.append(f"the transforms of {', '.join(sorted(circling))} go round in a circle: they are not used")
    return [link for link in good if link.child not in circling], warnings


def _apart(links: list[RecordedLink]) -> str | None:
    """Return how far several poses of one frame are apart, in words; None if they are one."""
    first = links[0].T
    for link in links[1:]:
        distance_m = float(np.linalg.norm(link.T[:3, 3] - first[:3, 3]))
        angle_deg = rotation_angle_deg(first[:3, :3].T @ link.T[:3, :3])
        if distance_m > 1e-3 or angle_deg > 0.1:
            return f"{distance_m:.3f} m and {angle_deg:.1f} deg apart"
    return None


def rotation_angle_deg(R: Array) -> float:
    """Return the angle of a rotation matrix (3, 3) [deg]."""
    return float(np.degrees(np.arccos(np.clip((np.trace(R) - 1.0) / 2.0, -1.0, 1.0))))


def _circling(links: list[RecordedLink]) -> Iterator[str]:
    parents = {link.child: link.parent for link in links}
    for start in parents:
        frame, seen = start, set()
        while frame in parents and frame not in seen:
            seen.add(frame)
            frame = parents[frame]
        if frame == start:
            yield start


def _words(path: tuple[str, ...], sources: Mapping[frozenset[str], str]) -> str:
    topics = dict.fromkeys(sources[frozenset(pair)] for pair in pairwise(path))
    return f"from {' and '.join(topics)}: {' - '.join(path)}"
