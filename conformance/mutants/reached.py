"""Which runs a mutant can end otherwise than the oracle: those that come to what it changes.

Until a run comes to the first changed statement of a function, the mutant does what the oracle
does. So the oracle is run once, in a form that notes each statement before it is done, and a mutant
is run only where that happened. Statements are known by the lines they begin on. A change outside
functions (constants, fields, signatures, decorators) may be seen by any run.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import takewhile
from types import CodeType

from conformance.decoders.outcomes import Outcome, Run
from conformance.mutants.mutant import module_of, original
from conformance.mutants.trial import outcome

__all__ = ["changed_lines", "lines_reached"]

BLOCKS = ("body", "orelse", "finalbody", "handlers")  # of statements
NOTE = "__note__"  # what the marked oracle calls before each statement, with its line

Block = Sequence[ast.stmt]


class _AnywhereError(Exception):
    """A change that any run may see."""


def lines_reached(data: bytes, run: Run) -> tuple[Outcome, frozenset[int]]:
    """How the oracle ends a run, and where the statements begin that it comes to.

    The module is a new one each time, so that nothing kept from another run hides a statement.
    """
    lines = set[int]()
    module = module_of("marked", _marked(original()), {NOTE: lines.add})
    return outcome(module, data, run), frozenset(lines)


def changed_lines(old: str, new: str) -> frozenset[int] | None:
    """Where a run must come to before two programs can differ.

    Returns:
        Lines of `old` on which statements begin. A run that comes to none of them is the same in
        both. None: any run may differ.
    """
    try:
        return frozenset(_in_scope(_parsed(old).body, ast.parse(new).body))
    except _AnywhereError:
        return None


@cache
def _marked(text: str) -> CodeType:
    """A program that calls `NOTE` before each statement of its functions."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.expr):
            continue
        for name in BLOCKS[:3]:
            block = getattr(node, name, [])
            block[:] = [one for statement in block for one in (_note(statement), statement)]
    return compile(tree, "oracle.py with marks", "exec")


def _note(statement: ast.stmt) -> ast.stmt:
    call = ast.Call(ast.Name(NOTE, ast.Load()), [ast.Constant(statement.lineno)], [])
    return ast.fix_missing_locations(ast.copy_location(ast.Expr(call), statement))


@cache
def _parsed(text: str) -> ast.Module:
    return ast.parse(text)


def _in_scope(old: Block, new: Block) -> Iterator[int]:
    """Changed lines of a module or class: only in functions, or any run may see them."""
    if len(old) != len(new):
        raise _AnywhereError
    for before, after in zip(old, new, strict=True):
        if _same(before, after):
            continue
        if not _same(_head(before), _head(after)):
            raise _AnywhereError
        if isinstance(before, ast.FunctionDef) and isinstance(after, ast.FunctionDef):
            yield from _in_function(before, after)
        elif isinstance(before, ast.ClassDef) and isinstance(after, ast.ClassDef):
            yield from _in_scope(before.body, after.body)
        else:
            raise _AnywhereError


def _in_function(old: ast.FunctionDef, new: ast.FunctionDef) -> Iterator[int]:
    """Where bodies differ; if a name becomes or ceases to be local, from the first statement on."""
    (kind, names), (new_kind, new_names) = _locals(old), _locals(new)
    if kind != new_kind:  # a generator
        raise _AnywhereError
    if names != new_names:
        yield old.body[0].lineno
    yield from _in_block(old, old.body, new.body)


def _locals(function: ast.FunctionDef) -> tuple[int, set[str]]:
    """Flags of the function, such as that of generators; its own names."""
    module = compile(ast.Module([function], []), function.name, "exec")
    codes = (const for const in module.co_consts if isinstance(const, CodeType))
    code = next(code for code in codes if code.co_name == function.name)
    return code.co_flags, {*code.co_varnames, *code.co_cellvars}


def _in_block(owner: ast.stmt | ast.ExceptHandler, old: Block, new: Block) -> Iterator[int]:
    """Where the statements of a block first differ; `owner` is what the block belongs to."""
    begin = _n_same(old, new)
    end = _n_same(old[begin:][::-1], new[begin:][::-1])
    gone, come = old[begin : len(old) - end], new[begin : len(new) - end]
    if len(gone) == len(come):
        for before, after in zip(gone, come, strict=True):
            yield from _in_statement(before, after)
    elif begin < len(old):  # the first that goes, or the one that others come before
        yield old[begin].lineno
    else:  # others come at the end
        yield (old[-1] if old else owner).lineno


def _in_statement(old: ast.stmt, new: ast.stmt) -> Iterator[int]:
    """Where two statements in the same place differ: in blocks inside, or from the first on."""
    if _same(old, new):
        return
    is_scope = isinstance(old, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
    handlers, new_handlers = getattr(old, "handlers", []), getattr(new, "handlers", [])
    heads = [_head(one) for one in (old, *handlers)]
    new_heads = [_head(one) for one in (new, *new_handlers)]
    if is_scope or len(heads) != len(new_heads) or not all(map(_same, heads, new_heads)):
        yield old.lineno
        return
    for before, after in zip((old, *handlers), (new, *new_handlers), strict=True):
        for name in BLOCKS[:3]:
            yield from _in_block(before, getattr(before, name, []), getattr(after, name, []))


def _n_same(old: Block, new: Block) -> int:
    """How many statements from the first on are the same."""
    return sum(1 for _ in takewhile(lambda pair: _same(*pair), zip(old, new, strict=False)))


def _same(old: ast.AST, new: ast.AST) -> bool:
    return ast.dump(old) == ast.dump(new)


def _head(statement: ast.AST) -> ast.AST:
    """A statement without the blocks inside it."""
    fields = ast.iter_fields(statement)
    return type(statement)(**{name: [] if name in BLOCKS else value for name, value in fields})
