"""The trade: every method's speed beside its error, on recordings and on known answers."""

from fastatt.trade.advice import recommend
from fastatt.trade.bodies import BODY_SCENES, BodyScene, body_cases, body_scene, body_trade
from fastatt.trade.coning import coning_cases, coning_rates, coning_trade
from fastatt.trade.each import OwnSteps, own_steps
from fastatt.trade.error_budget import ErrorBudget, error_budget
from fastatt.trade.measure import Case, Problem, Row, State, frontier, trade_table
from fastatt.trade.order import self_check
from fastatt.trade.recommendation import Recommendation
from fastatt.trade.recordings import (
    RECORDINGS,
    LogRow,
    compare_on_log,
    find_recordings,
    log_rows,
    log_table,
)
from fastatt.trade.reference import Reference, confirm, coning_attitudes, reference
from fastatt.trade.run import DEFAULT_SCENES, SCENES, run_trade
from fastatt.trade.work_precision import WorkPrecision, work_precision

__all__ = [
    "BODY_SCENES", "DEFAULT_SCENES", "RECORDINGS", "SCENES", "BodyScene", "Case", "ErrorBudget",
    "LogRow", "OwnSteps", "Problem", "Recommendation", "Reference", "Row", "State", "WorkPrecision",
    "body_cases", "body_scene", "body_trade", "compare_on_log", "confirm", "coning_attitudes",
    "coning_cases", "coning_rates", "coning_trade", "error_budget", "find_recordings", "frontier",
    "log_rows", "log_table", "own_steps", "recommend", "reference", "run_trade", "self_check",
    "trade_table", "work_precision",
]  # fmt: skip
