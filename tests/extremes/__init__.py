"""Every method at the extremes: what ``extremes.page`` writes down."""
