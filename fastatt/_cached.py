"""``functools.cached_property`` without its lock.

In Python 3.11 one lock serves a property of all instances, and is held while a value is computed.
A thread that computes one and waits for the compiler would stop another thread that compiles and
asks for the property of another instance. From Python 3.12 on ``functools`` has no lock either.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from functools import cached_property as cached_property  # noqa: PLC0414  # exported
else:

    class cached_property:  # noqa: N801  # as in functools
        """An attribute that is computed when it is first read."""

        def __init__(self, compute):
            self._compute, self.__doc__ = compute, compute.__doc__

        def __set_name__(self, owner, name):
            self._name = name

        def __get__(self, instance, owner):
            if instance is None:
                return self
            # two threads may both compute it; they get one value
            return instance.__dict__.setdefault(self._name, self._compute(instance))
