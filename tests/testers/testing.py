"""Cases of random testers: how many, of which seeds, and what they say.

A case is a function of a seed (and of a folder) that gives an outcome, and what is wrong or "".
The first seed follows from the date, so that each day has other cases; ``FASTATT_SEED`` sets it,
and ``FASTATT_MINUTES`` how long each tester runs (``make fuzz MINUTES=30``).
"""

from __future__ import annotations

import datetime as dt
import os
import signal
from collections import Counter
from collections.abc import Callable
from time import monotonic

SECONDS = 60.0 * float(os.environ.get("FASTATT_MINUTES", "0.8"))
LONGEST = 120  # s of a case, else it is taken for endless
MOST = 3  # findings after which a tester ends


def first_seed() -> int:
    """Of today, or as set."""
    today = dt.datetime.now(tz=dt.UTC).date()
    return int(os.environ.get("FASTATT_SEED", f"{today:%Y%m%d}00000"))


def try_cases(
    name: str, case: Callable[[int], tuple[str, str]], share: float = 1.0
) -> Counter[str]:
    """Run cases for a share of the time; the outcomes, counted. Raises for what is wrong."""
    signal.signal(signal.SIGALRM, _give_up)
    seed, begun, outcomes, wrong = first_seed(), monotonic(), Counter[str](), []
    while monotonic() - begun < share * SECONDS and len(wrong) < MOST:
        signal.alarm(LONGEST)
        try:
            outcome, complaint = case(seed)
        except TimeoutError:
            outcome, complaint = "endless", f"takes more than {LONGEST} s"
        finally:
            signal.alarm(0)
        outcomes[outcome] += 1
        if complaint:
            wrong.append(f"FASTATT_SEED={seed}: {complaint}"[:4000])
        seed += 1
    told = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.most_common(12))
    print(f"{name}: seeds from {first_seed()}, {outcomes.total()} cases: {told}")
    assert not wrong, "\n".join(wrong)
    return outcomes


def _give_up(*_: object) -> None:
    raise TimeoutError
