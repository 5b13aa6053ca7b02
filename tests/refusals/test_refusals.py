"""What is refused: one line that names the argument, says what was found and what is accepted."""

from __future__ import annotations

import re

import pytest
from each import each

from refusals import estimations, methods, models, numbers, runs, samples, scenes

TABLES = (runs, scenes, models, methods, samples, estimations, numbers)


@pytest.mark.filterwarnings("ignore::fastatt.StepWarning", "ignore::RuntimeWarning")
@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.__name__.partition(".")[2])
def test_the_message(table):
    """That of a table, where … stands for anything; a ``ValueError`` where no other is named."""

    @each("message, call, error", [(*row, ValueError)[:3] for row in table.REFUSED])
    def is_refused(message, call, error):
        with pytest.raises(error) as caught:
            call()
        said = str(caught.value)
        assert re.match(".*".join(map(re.escape, message.split("…"))), said), said
        assert len(said.splitlines()) == 1
        assert len(said) < 600

    is_refused()
