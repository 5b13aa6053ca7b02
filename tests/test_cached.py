"""Attributes that are computed when they are first read, by several threads at once."""

import threading

from fastatt._cached import cached_property


class Kept:
    """A value that is computed only when that of another instance is known."""

    def __init__(self, other=None):
        self.other, self.computed = other, []

    @cached_property
    def value(self):
        """The value."""
        if self.other is not None:
            thread = threading.Thread(target=lambda: self.other.value, daemon=True)
            thread.start()
            thread.join(timeout=10.0)
            assert not thread.is_alive()
        self.computed.append(object())
        return self.computed[-1]


def test_a_value_is_computed_while_another_thread_computes_another_instances():
    """With one lock for both, as in ``functools`` of Python 3.11, neither thread would go on."""
    other = Kept()
    assert Kept(other).value
    assert other.computed == [other.value]


def test_threads_that_compute_one_value_get_the_same():
    both = threading.Barrier(2, timeout=10.0)

    class Together:
        @cached_property
        def value(self):
            both.wait()
            return object()

    kept, found = Together(), []
    threads = [threading.Thread(target=lambda: found.append(kept.value)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [kept.value] * 2
    assert Kept.value.__doc__ == "The value."
