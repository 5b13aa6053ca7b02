"""The trade: every method's speed beside its error, on recordings and on known answers."""
