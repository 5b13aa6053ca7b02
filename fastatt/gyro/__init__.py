"""Integration of sampled rates and angle increments to attitudes."""
