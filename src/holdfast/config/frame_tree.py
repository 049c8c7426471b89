"""The frames that rigid transforms join; the tree may be walked from any of its frames, in either direction."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from holdfast.messages import Array


class Link(NamedTuple):
    """One transform: the pose T_parent_child of a frame in another, as a (4, 4) matrix [m]."""

    parent: str
    child: str
    T: Array


def links_from(origin: str, links: Iterable[Link]) -> Iterator[Link]:
    """Yield the links that lead from a frame to all that are joined to it; each goes away from `origin`.

    Those against the direction in which they are given are inverted, so that no frame has two parents.
    """
    neighbours: dict[str, list[Link]] = {}
    for parent, child, T in links:
        neighbours.setdefault(parent, []).append(Link(parent, child, T))
        inverse = np.asarray(np.linalg.inv(T), dtype=np.float64)
        neighbours.setdefault(child, []).append(Link(child, parent, inverse))
    reached, frontier = {origin}, [origin]
    while frontier:
        for link in neighbours.get(frontier.pop(), []):
            if link.child not in reached:
                reached.add(link.child)
                frontier.append(link.child)
                yield link


def poses_from(origin: str, links: Iterable[Link]) -> dict[str, Array]:
    """Return T_origin_frame (4, 4) [m] of every frame that is joined to `origin`, itself included."""
    poses = {origin: np.eye(4)}
    for parent, child, T in links_from(origin, links):
        poses[child] = poses[parent] @ T
    return poses
