"""Brackets of a crossing within a step: how the next point is chosen, and what its value tells."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fastatt._jit import loop_part

#: rows of brackets: ends and the values there, a point between them and its value, the next point
#: and its value, the radius of the bisection, the width that ends it, the largest squared rotation
#: angle of a step
LOW, HIGH, AT_LOW, AT_HIGH, INNER, AT_INNER, POINT, AT_POINT, RADIUS, LEAST, ROTATED = range(11)
#: what is done: a step; a step known to have no crossing; the extremum within a step is searched; a
#: crossing is bracketed; nothing was found; a crossing was
MARCH, PASS, EXTREMUM, BRACKET, NONE, FOUND = range(6)
#: evaluations of an extremum, and of a bracket, at most
FEW, MOST = 10, 80
_SMALLEST = float(np.finfo(np.float64).tiny)


def crosses(a: Any, b: Any, direction: int) -> Any:
    """Whether a function that goes from a to b reaches or leaves zero, rising, falling or both."""
    rises, falls = (a <= 0.0) & (b >= 0.0), (a >= 0.0) & (b <= 0.0)
    if direction == 0:
        return rises | falls
    return rises if direction > 0 else falls


def turns(a: Any, b: Any, c: Any) -> Any:
    """Whether a parabola of twice the curvature of a, b and c crosses zero between b and c.

    If the function crosses zero twice, the parabola does, unless the function's curvature doubles
    within a step.
    """
    bend, slope = 2.0 * (a - 2.0 * b + c), c - b
    square, steep = bend * bend, 4.0 * slope * slope
    product = bend * (b + c)
    return (product > 0.0) & (steep < square) & (4.0 * product < steep + square)


is_crossed, is_turned = loop_part(crosses), loop_part(turns)


@loop_part
def next_point(brackets, lanes, k):
    """The next point of a bracket (Oliveira and Takahashi, *ACM Trans. Math. Softw.* 47 (2020))."""
    low, high = brackets[LOW * lanes + k], brackets[HIGH * lanes + k]
    a, b = brackets[AT_LOW * lanes + k], brackets[AT_HIGH * lanes + k]
    middle, radius = 0.5 * (low + high), brackets[RADIUS * lanes + k]
    brackets[RADIUS * lanes + k] = 0.5 * radius
    slack = max(radius - 0.5 * (high - low), 0.0)
    point = low - a * ((high - low) / (b - a))
    side = 1.0 if middle >= point else -1.0
    away = max(0.2 * (high - low) ** 2, brackets[LEAST * lanes + k])
    point = point + side * away if away <= abs(middle - point) else middle
    return point if abs(point - middle) <= slack else middle - side * slack


@loop_part
def narrow_bracket(brackets, lanes, k, x, value):
    """Narrow a bracket by the value at a point; returns what to do next."""
    low, high = LOW * lanes + k, HIGH * lanes + k
    if math.isnan(value):
        return NONE
    if (value > 0.0) == (brackets[AT_LOW * lanes + k] > 0.0) and value != 0.0:
        brackets[low], brackets[AT_LOW * lanes + k] = x, value
    else:
        brackets[high], brackets[AT_HIGH * lanes + k] = x, value
    is_wide = brackets[high] - brackets[low] > 4.0 * brackets[LEAST * lanes + k]
    return BRACKET if value != 0.0 and is_wide else FOUND


@loop_part
def find_extremum(brackets, lanes, k, x, value, direction, trials):
    """Use the value at a point in the search of an extremum; returns what to do next.

    The function has the same sign at both ends of the step. Where it is exactly zero in between, it
    has crossed, and crosses back after that point.
    """
    low, high, inner = LOW * lanes + k, HIGH * lanes + k, INNER * lanes + k
    at_low, at_high, at_inner = AT_LOW * lanes + k, AT_HIGH * lanes + k, AT_INNER * lanes + k
    # the two parts of the bracket next to the point, up to the nearest points with a value
    left = brackets[low], brackets[at_low]
    right = brackets[high], brackets[at_high]
    if value == 0.0:
        value = -math.copysign(_SMALLEST, left[1] + right[1])
    if trials > 1:
        if x < brackets[inner]:
            right = brackets[inner], brackets[at_inner]
        else:
            left = brackets[inner], brackets[at_inner]
    for a, b, c, d in ((left[0], left[1], x, value), (x, value, right[0], right[1])):
        if is_crossed(b, d, direction):
            brackets[low], brackets[at_low] = a, b
            brackets[high], brackets[at_high] = c, d
            brackets[RADIUS * lanes + k] = c - a
            return BRACKET
    if trials > 1 and abs(brackets[at_inner]) < abs(value):
        if x < brackets[inner]:
            brackets[low], brackets[at_low] = x, value
        else:
            brackets[high], brackets[at_high] = x, value
    else:
        brackets[low], brackets[at_low] = left
        brackets[high], brackets[at_high] = right
        brackets[inner], brackets[at_inner] = x, value
    # the vertex of the parabola through the three, or nearer to the end beyond which that lies
    p, q = brackets[inner] - brackets[low], brackets[inner] - brackets[high]
    u = p * (brackets[at_inner] - brackets[at_high])
    v = q * (brackets[at_inner] - brackets[at_low])
    point = brackets[inner] - 0.5 * (p * u - q * v) / (u - v)
    if not brackets[low] < point < brackets[high]:
        point = 0.5 * (brackets[inner] + brackets[low if point <= brackets[low] else high])
    brackets[POINT * lanes + k] = point
    bends = (u - v) * (p * q) * brackets[at_inner] > 0.0
    is_new = abs(point - brackets[inner]) > 1e-7
    return EXTREMUM if bends and is_new and trials < FEW else PASS
