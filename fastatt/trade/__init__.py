"""The trade: every method's speed beside its error, on recordings and on known answers."""

from fastatt.trade.bodies import BODY_SCENES, BodyScene, body_cases, body_scene, body_trade
from fastatt.trade.coning import coning_attitudes, coning_cases, coning_rates, coning_trade
from fastatt.trade.measure import Case, Problem, Row, frontier, trade_table
from fastatt.trade.recordings import (
    RECORDINGS,
    LogRow,
    compare_on_log,
    find_recordings,
    log_rows,
    log_table,
)
from fastatt.trade.run import DEFAULT_SCENES, SCENES, run_trade

__all__ = [
    "BODY_SCENES",
    "DEFAULT_SCENES",
    "RECORDINGS",
    "SCENES",
    "BodyScene",
    "Case",
    "LogRow",
    "Problem",
    "Row",
    "body_cases",
    "body_scene",
    "body_trade",
    "compare_on_log",
    "coning_attitudes",
    "coning_cases",
    "coning_rates",
    "coning_trade",
    "find_recordings",
    "frontier",
    "log_rows",
    "log_table",
    "run_trade",
    "trade_table",
]
