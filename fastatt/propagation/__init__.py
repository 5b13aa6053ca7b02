"""From the arguments of a run to its trajectory: checking, planning, executing and evaluating."""
