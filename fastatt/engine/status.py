"""What a run says of each body."""

from __future__ import annotations

from enum import IntFlag


class Status(IntFlag):
    """What went wrong with one body; 0 where nothing did.

    Of a user's rate function on quaternions one step in seven is looked at: a single burst that is
    shorter may pass without ``STEP_TOO_LARGE``.
    """

    OK = 0
    NON_FINITE = 1  #: the state holds NaN or infinity
    STEP_TOO_LARGE = 2  #: a step turned further than the method's limit
    INVARIANT = 4  #: the energy or |m|² of a free body changed by more than 1 %
    SINGULAR = 8  #: the representation's coordinates passed too near their singularity
    NOT_CONVERGED = 16  #: an implicit step's iteration did not converge
    NORM_LOST = 32  #: the state left its group by more than round-off explains
    UNFINISHED = 64  #: the run was interrupted before its end
