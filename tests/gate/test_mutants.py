"""Every mutant of the gate is killed by the gate's own tests; no mutant is excused."""

import ast
import copy
import importlib.util
import sys
import types
from collections.abc import Callable, Iterator
from pathlib import Path

import workgauge.gate.gate as original

SOURCE = Path(original.__file__)

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.FloorDiv,
    ast.Mod: ast.Mult,
}
CALLS = {"any": "all", "all": "any", "abs": "int", "min": "max", "max": "min"}


def expressions(node: ast.expr) -> Iterator[ast.expr]:
    """What an expression may be replaced by."""
    if isinstance(node, ast.Compare):
        for i, op in enumerate(node.ops):
            for other in COMPARISONS[type(op)]:
                yield ast.Compare(node.left, [*node.ops[:i], other(), *node.ops[i + 1 :]], node.comparators)
    elif isinstance(node, ast.BoolOp):
        yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
        yield from node.values
    elif isinstance(node, ast.BinOp) and type(node.op) in ARITHMETIC:
        yield ast.BinOp(node.left, ARITHMETIC[type(node.op)](), node.right)
    elif isinstance(node, ast.UnaryOp):
        yield node.operand
    elif isinstance(node, ast.IfExp):
        yield node.body
        yield node.orelse
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int):
        yield ast.Constant(node.value + 1)
        yield ast.Constant(node.value - 1)
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in CALLS:
        yield ast.Call(ast.Name(CALLS[node.func.id], ast.Load()), node.args, node.keywords)


def statements(node: ast.stmt) -> Iterator[ast.stmt]:
    """What a statement may be replaced by."""
    is_docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    if not is_docstring and not isinstance(node, ast.Pass):
        yield ast.Pass()
    if isinstance(node, ast.Return) and node.value is not None:
        yield ast.Return(ast.Constant(None))
        if isinstance(node.value, ast.List) and node.value.elts:
            yield ast.Return(ast.List([], ast.Load()))
    if isinstance(node, ast.If):
        for constant in (True, False):
            yield ast.If(ast.Constant(constant), node.body, node.orelse)


def mutants(source: str) -> Iterator[tuple[str, ast.Module]]:
    """Every mutant of a module, each with one change: (what and where, tree)."""
    tree = ast.parse(source)
    for index, node in enumerate(ast.walk(tree)):
        if isinstance(node, ast.expr):
            changes: list[ast.expr] | list[ast.stmt] = list(expressions(node))
        elif isinstance(node, ast.stmt):
            changes = list(statements(node))
        else:
            continue
        for change in changes:
            mutant = copy.deepcopy(tree)
            target = next(n for i, n in enumerate(ast.walk(mutant)) if i == index)
            replace(mutant, target, change)
            assert isinstance(node, ast.expr | ast.stmt)
            where = (
                f"line {node.lineno}: {ast.unparse(node).splitlines()[0]} -> {ast.unparse(change).splitlines()[0]}"
            )
            yield where, ast.fix_missing_locations(mutant)


def replace(tree: ast.AST, target: ast.AST, change: ast.AST) -> None:
    """Put `change` where `target` stands in the tree."""
    for parent in ast.walk(tree):
        for name, value in ast.iter_fields(parent):
            if value is target:
                setattr(parent, name, change)
                return
            if isinstance(value, list):
                for i, item in enumerate(value):
                    if item is target:
                        value[i] = change
                        return
    raise AssertionError("the target is not in the tree")


def gate_tests() -> tuple[types.ModuleType, dict[str, Callable[[], None]]]:
    """The gate's case tests, as a module of their own so that its `gate` can be exchanged."""
    spec = importlib.util.spec_from_file_location("gate_cases", Path(__file__).with_name("test_gate.py"))
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module, {name: f for name, f in vars(module).items() if name.startswith("test_")}


def load(tree: ast.Module) -> types.ModuleType:
    """The module a tree makes; it stands in `sys.modules` only while it is made, as dataclasses look there."""
    module = types.ModuleType("gate_mutant")
    sys.modules[module.__name__] = module
    try:
        exec(compile(tree, str(SOURCE), "exec"), module.__dict__)
    finally:
        del sys.modules[module.__name__]
    return module


def killed_by(tree: ast.Module, cases: types.ModuleType, tests: dict[str, Callable[[], None]]) -> str | None:
    """Name of the first test that fails on the mutant, or None if it survives."""
    try:
        cases.gate = load(tree)  # type: ignore[attr-defined]
    except Exception:
        return "import"
    for name, test in tests.items():
        try:
            test()
        except (Exception, BaseExceptionGroup):
            return name
        except BaseException as failure:  # pytest's own failures are no Exceptions
            if type(failure).__name__ == "Failed":
                return name
            raise
    return None


def test_the_unchanged_gate_survives() -> None:
    cases, tests = gate_tests()
    assert len(tests) >= 25
    assert killed_by(ast.parse(SOURCE.read_text()), cases, tests) is None


def test_every_mutant_is_killed() -> None:
    cases, tests = gate_tests()
    total, survivors = 0, []
    for where, tree in mutants(SOURCE.read_text()):
        total += 1
        if killed_by(tree, cases, tests) is None:
            survivors.append(where)
    print(f"{total - len(survivors)} of {total} mutants killed")
    assert total > 250
    assert not survivors, "\n".join(survivors)


def test_the_gate_is_one_module() -> None:
    """What the mutants cover is all there is."""
    assert sorted(p.name for p in SOURCE.parent.glob("*.py")) == ["__init__.py", "gate.py"]
