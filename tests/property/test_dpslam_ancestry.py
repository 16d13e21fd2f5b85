"""Whatever happens to the particles, the tree is the smallest one that tells their paths."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.dpslam.ancestry import NONE, Ancestry

PARTICLES = 6


@st.composite
def parents(draw):
    """Who descends from whom, survivors in their own places."""
    chosen = np.array(draw(st.lists(st.integers(0, PARTICLES - 1), min_size=PARTICLES, max_size=PARTICLES)))
    children = np.bincount(chosen, minlength=PARTICLES)
    arranged = np.arange(PARTICLES, dtype=np.int32)
    arranged[children == 0] = np.repeat(arranged, np.maximum(children - 1, 0))
    return arranged


events = st.lists(st.one_of(st.just("extend"), st.just("restart"), parents()), min_size=1, max_size=40)


def walk(tree, paths, sequence):
    number = 0.0
    for event in sequence:
        if isinstance(event, str) and event == "restart":
            trunk = np.array(paths[0]).reshape(-1, 3) + 0.5
            tree.restart(trunk)
            paths[:] = [[tuple(pose) for pose in trunk.tolist()] for _ in range(PARTICLES)]
        elif isinstance(event, str):
            poses = np.arange(3.0 * PARTICLES).reshape(PARTICLES, 3) + 100.0 * number
            number += 1.0
            tree.extend(poses)
            for path, pose in zip(paths, poses.tolist(), strict=True):
                path.append(tuple(pose))
        else:
            tree.resample(event)
            paths[:] = [list(paths[p]) for p in event]


@given(events)
@settings(max_examples=150, deadline=None)
def test_paths_are_those_of_lists_that_are_copied_whole(sequence):
    tree, paths = Ancestry(PARTICLES), [[] for _ in range(PARTICLES)]
    walk(tree, paths, sequence)
    for particle, path in enumerate(paths):
        assert tree.path(particle).tolist() == [list(pose) for pose in path]


@given(events)
@settings(max_examples=150, deadline=None)
def test_leaves_are_particles_inner_nodes_branch_and_nothing_leaks(sequence):
    tree, paths = Ancestry(PARTICLES), [[] for _ in range(PARTICLES)]
    walk(tree, paths, sequence)
    nodes = np.flatnonzero(tree.alive)
    leaves = set(tree.leaves.tolist())
    assert len(leaves) == PARTICLES
    assert tree.node_count <= 2 * PARTICLES - 1
    counted = np.bincount(tree.nodes[nodes, 0][tree.nodes[nodes, 0] != NONE], minlength=len(tree.alive))
    for node in nodes:
        assert tree.nodes[node, 1] == counted[node]
        if node in leaves:
            assert counted[node] == 0
        else:
            assert counted[node] >= 2  # no only children, no childless ancestors
        parent = tree.nodes[node, 0]
        assert parent == NONE or tree.alive[parent]
    # Every record in use is reached from a leaf, once: what the dead knew is given back.
    reached = set()
    for leaf in leaves:
        at = tree.nodes[leaf, 2]
        while at != NONE:
            reached.add(int(at))
            at = tree.previous[at]
    assert tree.record_count == len(reached)


@given(events, events)
@settings(max_examples=40, deadline=None)
def test_a_restored_tree_goes_on_as_the_first_one(before, after):
    tree, paths = Ancestry(PARTICLES), [[] for _ in range(PARTICLES)]
    walk(tree, paths, before)
    twin, twin_paths = Ancestry(PARTICLES), [list(path) for path in paths]
    twin.restore(tree.state())
    walk(tree, paths, after)
    walk(twin, twin_paths, after)
    for name, value in tree.state().items():
        assert np.array_equal(value, twin.state()[name]), name


def test_records_do_not_grow_with_time_where_all_descend_from_one():
    tree = Ancestry(PARTICLES)
    for number in range(500):
        tree.extend(np.full((PARTICLES, 3), float(number)))
        tree.resample(np.zeros(PARTICLES, dtype=np.int32))
    assert tree.record_count == 500
    assert tree.node_count == PARTICLES + 1
