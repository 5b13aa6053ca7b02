"""An order of operations in which few results wait: those that do take the processor's registers.

Goodman and Hsu, *Code scheduling and register allocation in large basic blocks* (1988): of what can
be done next, what frees most; of equals what was written first.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from heapq import heapify, heappop, heappush

from fastatt.tracing.nodes import Node, operands

#: results that may wait before the order is changed: a processor has 16 or 32 registers
_REGISTERS = 24


def ordered(made: Sequence[Node], ends: Iterable[int]) -> list[int]:
    """The operations' numbers in a better order, if there is need; ``ends`` are asked for."""
    order = range(len(made))
    free = {i for i in order if made[i].op in ("const", "in")}
    taken = {i: set(operands(made[i])) - free for i in order}
    kept = set(ends)
    if _waiting(order, taken, kept, free) <= _REGISTERS:
        return list(order)
    users: dict[int, list[int]] = {i: [] for i in order}
    for i in order:
        for k in taken[i]:
            users[k].append(i)
    missing = {i: len(taken[i]) for i in order}
    left = {i: len(users[i]) + (i in kept) for i in order}
    done = set(free)

    def cost(i: int) -> int:
        return -sum(left[k] == 1 for k in taken[i])

    found = [i for i in order if i in free]
    ready = [(cost(i), i) for i in order if i not in free and not missing[i]]
    heapify(ready)
    while ready:
        _, i = heappop(ready)
        if i in done:
            continue
        done.add(i)
        found.append(i)
        for k in taken[i]:
            left[k] -= 1
            if left[k] == 1:
                # its last user frees it, which is worth more than it was
                for j in users[k]:
                    if j not in done and not missing[j]:
                        heappush(ready, (cost(j), j))
        for j in users[i]:
            missing[j] -= 1
            if not missing[j]:
                heappush(ready, (cost(j), j))
    return found


def _waiting(
    order: Sequence[int], taken: Mapping[int, set[int]], kept: set[int], free: set[int]
) -> int:
    """Most results that wait at once."""
    uses = {i: int(i in kept) for i in order}
    for i in order:
        for k in taken[i]:
            uses[k] += 1
    live = most = 0
    for i in order:
        if i in free:
            continue
        live += 1
        most = max(most, live)
        for k in taken[i]:
            uses[k] -= 1
            live -= uses[k] == 0
    return most
