"""Cuts between sets of nodes and a root, by maximum flow (Ford and Fulkerson 1956, Edmonds and Karp 1972)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.world.kernel import kernel

_TINY = 1e-9  # remaining capacity that counts as none: it may make a cut weaker, but never invalid


class Network(NamedTuple):
    """An undirected graph with n nodes and m edges.

    Attributes
    ----------
    ends : ndarray of int32, shape (m, 2)
        The two ends of every edge.
    first : ndarray of int32, shape (n + 1,)
        Where the arcs of every node begin in ``arcs``.
    arcs : ndarray of int32, shape (2m,)
        2e for the arc of edge e from its first end to its second, 2e + 1 for the arc back.
    """

    ends: NDArray[np.int32]
    first: NDArray[np.int32]
    arcs: NDArray[np.int32]


def network(nodes: int, ends: NDArray[np.int32]) -> Network:
    """Return the graph with the edges ``ends``."""
    tails = ends.reshape(-1)
    arcs = np.argsort(tails, kind="stable").astype(np.int32)
    first = np.searchsorted(tails[arcs], np.arange(nodes + 1)).astype(np.int32)
    return Network(ends, first, arcs)


@kernel
def violated_cuts(
    graph: Network,
    capacity: NDArray[np.float64],
    root: int,
    first: NDArray[np.int32],
    members: NDArray[np.int32],
    demand: NDArray[np.float64],
    tolerance: float,
    nested: int,
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Return sets of nodes around terminals whose cut to ``root`` has less capacity than the terminals demand.

    Parameters
    ----------
    graph : Network
        n nodes, m edges.
    capacity : ndarray of float64, shape (m,)
        The capacity of every edge, in both directions together.
    root : int
        A node.
    first, members : ndarray of int32, shapes (T + 1,) and (any,)
        The nodes of terminal t are ``members[first[t]:first[t + 1]]``; the root is not one of them.
    demand : ndarray of float64, shape (T,)
        The capacity that the cut of every set around a terminal should have.
    tolerance : float
        By how much the capacity of a cut must be below the demand.
    nested : int
        How many times cuts of a terminal are sought. Each time there are at most two, the one nearest to the root and the one
        nearest to the terminal; before the next time, the capacity of their edges is raised to the demand.

    Returns
    -------
    terminal : ndarray of int32, shape (C,)
        The terminal of each set.
    inside : ndarray of bool, shape (C, n)
        The sets. Each contains all nodes of its terminal, and not the root.
    """
    nodes, terminals = len(graph.first) - 1, len(first) - 1
    terminal = np.empty(2 * nested * terminals, dtype=np.int32)
    inside = np.empty((2 * nested * terminals, nodes), dtype=np.bool_)
    found = 0
    flow, opened = np.empty(len(capacity)), np.empty(len(capacity))
    reached, into, queue = np.empty(nodes, np.bool_), np.empty(nodes, np.int32), np.empty(nodes, np.int32)
    for t in range(terminals):
        sources = members[first[t] : first[t + 1]]
        flow[:] = 0.0
        opened[:] = capacity
        sent = 0.0
        for _ in range(nested):
            sent += _send(graph, opened, sources, root, demand[t] - sent, flow, reached, into, queue)
            if sent >= demand[t] - tolerance:
                break
            near, far = inside[found], inside[found + 1]
            near[:] = reached
            _mark_reaching(graph, opened, root, flow, far, queue)
            far[:] = ~far
            terminal[found : found + 2] = t
            found += 2 if (near != far).any() else 1
            for e in range(len(capacity)):
                a, b = graph.ends[e]
                if near[a] != near[b] or far[a] != far[b]:
                    opened[e] = demand[t]
    return terminal[:found].copy(), inside[:found].copy()


@kernel
def cut_rows(
    ends: NDArray[np.int32],
    inside: NDArray[np.bool_],
    offset: int,
    first: NDArray[np.int64],
    terminal: NDArray[np.int64],
    share: NDArray[np.float64],
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
    """Return the rows x(δS) − 2 Σ share x_t of a sparse matrix: where they begin, their columns and their values.

    Parameters
    ----------
    ends : ndarray of int32, shape (m, 2)
        The ends of the edges; edge e has the column ``offset`` + e.
    inside : ndarray of bool, shape (C, n)
        The sets S.
    offset : int
        The number of columns before those of the edges.
    first : ndarray of int64, shape (C + 1,)
        The terminals t of set k are the columns ``terminal[first[k]:first[k + 1]]``: several columns before ``offset``, or one,
        which may be the column of an edge.
    terminal : ndarray of int64
        The columns of the terminals.
    share : ndarray of float64
        The share of each terminal; the shares of a set sum to 1.
    """
    crossing = np.empty(len(ends), dtype=np.int32)
    begin = np.zeros(len(inside) + 1, dtype=np.int32)
    for k in range(len(inside)):
        begin[k + 1] = begin[k] + _cross(ends, inside[k], crossing)
        for column in terminal[first[k] : first[k + 1]]:
            begin[k + 1] += column < offset
    columns, values = np.empty(begin[-1], dtype=np.int32), np.ones(begin[-1])
    for k in range(len(inside)):
        count = _cross(ends, inside[k], crossing)
        edges = begin[k + 1] - count
        columns[edges : begin[k + 1]] = offset + crossing[:count]
        for n in range(edges - begin[k]):
            columns[begin[k] + n] = terminal[first[k] + n]
            values[begin[k] + n] = -2.0 * share[first[k] + n]
        for n in range(edges, begin[k + 1]):
            if columns[n] == terminal[first[k]]:
                values[n] -= 2.0
    return begin, columns, values


@kernel
def _cross(ends: NDArray[np.int32], inside: NDArray[np.bool_], crossing: NDArray[np.int32]) -> int:
    """Write the edges with exactly one end ``inside`` to ``crossing``; return how many."""
    count = 0
    for e in range(len(ends)):
        crossing[count] = e
        count += inside[ends[e, 0]] != inside[ends[e, 1]]
    return count


@kernel
def _send(
    graph: Network,
    capacity: NDArray[np.float64],
    sources: NDArray[np.int32],
    root: int,
    most: float,
    flow: NDArray[np.float64],
    reached: NDArray[np.bool_],
    into: NDArray[np.int32],
    queue: NDArray[np.int32],
) -> float:
    """Augment ``flow`` from the sources to the root by at most ``most``, along shortest paths; return by how much.

    If that is less than ``most``, the flow is a maximum, and ``reached`` holds the nodes that the sources could still send to.
    Searching from the sources is fast, because the cut of a terminal is mostly close to it.
    """
    sent = 0.0
    while sent < most - _TINY:
        reached[:] = False
        head = tail = 0
        for node in sources:
            reached[node] = True
            into[node] = -1
            queue[tail] = node
            tail += 1
        while head < tail and not reached[root]:
            node = queue[head]
            head += 1
            for arc in graph.arcs[graph.first[node] : graph.first[node + 1]]:
                other = graph.ends[arc >> 1, 1 - (arc & 1)]
                if not reached[other] and _left(capacity, flow, arc) > _TINY:
                    reached[other] = True
                    into[other] = arc
                    queue[tail] = other
                    tail += 1
        if not reached[root]:
            break
        amount, node = most - sent, root
        while into[node] >= 0:
            amount = min(amount, _left(capacity, flow, into[node]))
            node = graph.ends[into[node] >> 1, into[node] & 1]
        node = root
        while into[node] >= 0:
            flow[into[node] >> 1] += -amount if into[node] & 1 else amount
            node = graph.ends[into[node] >> 1, into[node] & 1]
        sent += amount
    return sent


@kernel
def _left(capacity: NDArray[np.float64], flow: NDArray[np.float64], arc: int) -> float:
    """Return what an arc can still carry; ``flow`` is signed, from an edge's first end to its second."""
    return capacity[arc >> 1] + (flow[arc >> 1] if arc & 1 else -flow[arc >> 1])


@kernel
def _mark_reaching(
    graph: Network,
    capacity: NDArray[np.float64],
    root: int,
    flow: NDArray[np.float64],
    reaching: NDArray[np.bool_],
    queue: NDArray[np.int32],
) -> None:
    """Set ``reaching`` to whether each node could still send to the root."""
    reaching[:] = False
    reaching[root] = True
    queue[0] = root
    head, tail = 0, 1
    while head < tail:
        node = queue[head]
        head += 1
        for arc in graph.arcs[graph.first[node] : graph.first[node + 1]]:
            other = graph.ends[arc >> 1, 1 - (arc & 1)]
            if not reaching[other] and _left(capacity, flow, arc ^ 1) > _TINY:
                reaching[other] = True
                queue[tail] = other
                tail += 1
