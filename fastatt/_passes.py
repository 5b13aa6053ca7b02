"""Other functions in place of some operations, in functions of users that Numba compiles.

Imported when the first of them is compiled, since Numba does not document most of what it uses.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numba import typeof, types
from numba.core import ir as numba_ir
from numba.core.analysis import compute_cfg_from_blocks
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.ir_utils import mk_unique_var
from numba.core.typed_passes import PreLowerStripPhis


def replacing(operations: Mapping[Any, Any], counted: Any) -> type:
    """A compiler, as a ``pipeline_class``, which calls functions instead of some operations.

    ``operations`` are those of whole numbers, by functions of ``operator``, and ``counted`` gives
    the number of rounds of a function's loops after the next one.
    """

    @register_pass(mutates_CFG=False, analysis_only=False)
    class Replaced(FunctionPass):  # type: ignore[misc]
        _name = "operations of whole numbers and loops"

        def __init__(self) -> None:
            super().__init__()

        def run_pass(self, state: Any) -> bool:
            blocks = state.func_ir.blocks
            for block in blocks.values():
                for x in [*block.body]:
                    e: Any = getattr(x, "value", None)
                    is_binary = isinstance(e, numba_ir.Expr) and e.op.endswith("binop")
                    of = state.calltypes[e].args if is_binary and e.fn in operations else [None]
                    if all(isinstance(kind, types.Integer) for kind in of):
                        function, at = operations[e.fn], block.body.index(x)
                        x.value = _call(state, block, at, function, e.lhs, e.rhs)
            first = blocks[min(blocks)]
            rounds = numba_ir.Var(first.scope, mk_unique_var("rounds"), first.loc)
            state.typemap[rounds.name] = types.int64
            for loop in compute_cfg_from_blocks(blocks).loops().values():
                block = blocks[loop.header]
                call = _call(state, block, 0, counted, rounds)
                block.body.insert(1, numba_ir.Assign(call, rounds, block.loc))
            none = numba_ir.Const(0, first.loc)
            first.body.insert(0, numba_ir.Assign(none, rounds, first.loc))
            return True

    class Replacing(CompilerBase):  # type: ignore[misc]
        def define_pipelines(self) -> list[Any]:
            passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
            passes.add_pass_after(Replaced, PreLowerStripPhis)
            passes.finalize()
            return [passes]

    return Replacing


def _call(state: Any, block: Any, at: int, function: Any, *args: Any) -> Any:
    """A call of a jitted function, which is read before the statement ``at`` of a block."""
    name, loc, kind = mk_unique_var("function"), block.loc, typeof(function)
    called = numba_ir.Var(block.scope, name, loc)
    block.body.insert(at, numba_ir.Assign(numba_ir.Global(name, function, loc), called, loc))
    call, given = numba_ir.Expr.call(called, args, (), loc), [state.typemap[x.name] for x in args]
    state.typemap[name] = kind
    state.calltypes[call] = kind.get_call_type(state.typingctx, given, {})
    return call
