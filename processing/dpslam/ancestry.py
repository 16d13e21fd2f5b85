"""The ancestry tree: who descends from whom, and the path that each lineage walked.

A particle is a leaf. A node holds a stretch of path; nodes without a child die, a node with one child is
merged into it, so P particles need fewer than 2 P nodes however long the run. Path records live in one pool
and point backwards; merging two nodes only joins their stretches, nothing is copied.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.growing import longer
from processing.se2 import Pose

NONE = -1


@njit("i4(i4[::1], i8[::1])", cache=True, nogil=True)
def _take(free: NDArray[np.int32], count: NDArray[np.int64]) -> int:
    """Pop a free row; `count[0]` rows are free."""
    count[0] -= 1
    return int(free[count[0]])


@njit("void(i4, i4, i4[:,::1], i4[::1], i4[::1], i8[::1])", cache=True, nogil=True)
def _free_stretch(
    head: int,
    tail: int,
    nodes: NDArray[np.int32],
    previous: NDArray[np.int32],
    free: NDArray[np.int32],
    count: NDArray[np.int64],
) -> None:
    """Give the records from `head` back to `tail` to the pool."""
    at = head
    while tail != NONE:
        free[count[0]] = at
        count[0] += 1
        if at == tail:
            break
        at = previous[at]


@njit("void(i4[::1], f8[:,::1], i4[:,::1], i4[::1], f8[:,::1], i4[::1], i8[::1])", cache=True, nogil=True)
def _extend(
    leaves: NDArray[np.int32],
    poses: NDArray[np.float64],
    nodes: NDArray[np.int32],
    previous: NDArray[np.int32],
    recorded: NDArray[np.float64],
    free: NDArray[np.int32],
    count: NDArray[np.int64],
) -> None:
    for i in range(leaves.shape[0]):
        node = leaves[i]
        record = _take(free, count)
        previous[record] = nodes[node, 2]
        for a in range(3):  # a row assigned to a row takes 1.7 s to compile
            recorded[record, a] = poses[i, a]
        nodes[node, 2] = record
        if nodes[node, 3] == NONE:
            nodes[node, 3] = record


@njit("void(i4[:,::1], u1[::1], i4[::1], i8[::1])", cache=True, nogil=True)
def _merge_only_children(
    nodes: NDArray[np.int32],
    alive: NDArray[np.uint8],
    free_nodes: NDArray[np.int32],
    node_count: NDArray[np.int64],
) -> None:
    size = nodes.shape[0]
    child = np.full(size, NONE, dtype=np.int32)
    for node in range(size):
        if alive[node] and nodes[node, 0] != NONE:
            child[nodes[node, 0]] = node
    for node in range(size):
        if not alive[node] or nodes[node, 1] != 1:
            continue
        heir = child[node]
        above = nodes[node, 0]
        nodes[heir, 0] = above
        if above != NONE and child[above] == node:
            child[above] = heir
        if nodes[node, 3] != NONE:
            nodes[heir, 3] = nodes[node, 3]
        alive[node] = 0
        free_nodes[node_count[0]] = node
        node_count[0] += 1


@njit(
    "void(i4[::1], i4[::1], i4[:,::1], u1[::1], i4[::1], i8[::1], i4[::1], i4[::1], i8[::1])",
    cache=True,
    nogil=True,
)
def _resample(
    leaves: NDArray[np.int32],
    parents: NDArray[np.int32],
    nodes: NDArray[np.int32],
    alive: NDArray[np.uint8],
    free_nodes: NDArray[np.int32],
    node_count: NDArray[np.int64],
    previous: NDArray[np.int32],
    free: NDArray[np.int32],
    count: NDArray[np.int64],
) -> None:
    """Let leaf i descend from the old leaf of particle `parents[i]`; bury the dead, merge only children."""
    particles = leaves.shape[0]
    old = leaves.copy()
    children = np.zeros(particles, dtype=np.int32)
    for i in range(particles):
        children[parents[i]] += 1
    # The dead go first, so that at most 2 P nodes exist at any time.
    for i in range(particles):
        node = old[i]
        if children[i] == 0:
            while node != NONE and nodes[node, 1] == 0:
                above = nodes[node, 0]
                _free_stretch(nodes[node, 2], nodes[node, 3], nodes, previous, free, count)
                alive[node] = 0
                free_nodes[node_count[0]] = node
                node_count[0] += 1
                if above != NONE:
                    nodes[above, 1] -= 1
                node = above
    _merge_only_children(nodes, alive, free_nodes, node_count)
    for i in range(particles):
        parent = old[parents[i]]
        if children[parents[i]] == 1:
            leaves[i] = parent
            continue
        node = _take(free_nodes, node_count)
        alive[node] = 1
        nodes[node, 0] = parent
        nodes[node, 1] = 0
        nodes[node, 2] = nodes[parent, 2]
        nodes[node, 3] = NONE
        nodes[parent, 1] += 1
        leaves[i] = node


class Ancestry:
    """Lineages of `particles` leaves, all starting from nothing.

    Node columns: parent, number of children, newest record, oldest record (of the node's own stretch).
    """

    def __init__(self, particles: int) -> None:
        # A resampling creates the new leaves while the old ones become inner nodes: one spare for each
        # particle.
        size = 3 * particles
        self.leaves = np.arange(particles, dtype=np.int32)
        self.nodes = np.full((size, 4), NONE, dtype=np.int32)
        self.nodes[:, 1] = 0
        self.alive = np.zeros(size, dtype=np.uint8)
        self.alive[:particles] = 1
        self._free_nodes = np.concatenate(
            (np.arange(size - 1, particles - 1, -1), np.zeros(particles))
        ).astype(np.int32)
        self._free_node_count = np.array([size - particles], dtype=np.int64)
        self.previous = np.full(0, NONE, dtype=np.int32)
        self.poses = np.zeros((0, 3))
        self._free = np.zeros(0, dtype=np.int32)
        self._free_count = np.zeros(1, dtype=np.int64)
        self._grow(64 * particles)

    @property
    def node_count(self) -> int:
        """Number of living nodes."""
        return int(self.alive.sum())

    @property
    def record_count(self) -> int:
        """Number of path records in use."""
        return int(self.previous.shape[0] - self._free_count[0])

    def extend(self, poses: Pose) -> None:
        """Append one pose (P, 3) to the path of each particle."""
        if self._free_count[0] < self.leaves.shape[0]:
            self._grow(max(self.previous.shape[0] // 2, self.leaves.shape[0]))
        _extend(self.leaves, poses, self.nodes, self.previous, self.poses, self._free, self._free_count)

    def resample(self, parents: NDArray[np.int32]) -> None:
        """Let particle i continue the lineage of particle `parents[i]`."""
        _resample(
            self.leaves,
            parents,
            self.nodes,
            self.alive,
            self._free_nodes,
            self._free_node_count,
            self.previous,
            self._free,
            self._free_count,
        )

    def restart(self, trunk: Pose) -> None:
        """Forget all lineages; let every particle descend from one path (K, 3)."""
        particles = self.leaves.shape[0]
        fresh = Ancestry(particles)
        self.__dict__.update(fresh.__dict__)
        length = trunk.shape[0]
        self._grow(length)
        if length == 0:
            return
        records = self._free[self._free_count[0] - length : self._free_count[0]][::-1].copy()
        self._free_count[0] -= length
        self.poses[records] = trunk
        self.previous[records] = np.concatenate(((NONE,), records[:-1]))
        self.nodes[self.leaves, 2] = records[-1]
        if particles == 1:
            self.nodes[0, 3] = records[0]
            return
        trunk_node = _take(self._free_nodes, self._free_node_count)
        self.alive[trunk_node] = 1
        self.nodes[trunk_node] = (NONE, particles, records[-1], records[0])
        self.nodes[self.leaves, 0] = trunk_node

    def path(self, particle: int) -> Pose:
        """Return the poses (K, 3) of one lineage, oldest first."""
        return _walk(int(self.nodes[self.leaves[particle], 2]), self.previous, self.poses)

    def state(self) -> dict[str, NDArray[Any]]:
        """Return all arrays; `restore` takes them back."""
        return {name: getattr(self, name).copy() for name in _STATE}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Become the tree whose `state` was taken."""
        for name in _STATE:
            setattr(self, name, state[name].copy())

    def _grow(self, rows: int) -> None:
        size = self.previous.shape[0]
        self.previous, self.poses = longer(self.previous, size + rows), longer(self.poses, size + rows)
        fresh = np.arange(size + rows - 1, size - 1, -1, dtype=np.int32)
        free = self._free[: self._free_count[0]]
        self._free = np.concatenate((free, fresh, np.zeros(size - free.shape[0], dtype=np.int32)))
        self._free_count[0] += rows


_STATE = (
    "leaves",
    "nodes",
    "alive",
    "_free_nodes",
    "_free_node_count",
    "previous",
    "poses",
    "_free",
    "_free_count",
)


@njit("f8[:,::1](i8, i4[::1], f8[:,::1])", cache=True, nogil=True)
def _walk(newest: int, previous: NDArray[np.int32], recorded: NDArray[np.float64]) -> NDArray[np.float64]:
    length = 0
    at = newest
    while at != NONE:
        length += 1
        at = previous[at]
    path = np.empty((length, 3))
    at = newest
    for k in range(length - 1, -1, -1):
        path[k, 0], path[k, 1], path[k, 2] = recorded[at, 0], recorded[at, 1], recorded[at, 2]
        at = previous[at]
    return path
