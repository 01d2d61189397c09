"""Translation of expressions to C: constants, members, operators and calls."""

from __future__ import annotations

import ast
import builtins
import inspect
import types
import typing
from collections import ChainMap, Counter
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from tools.c_translator.errors import NotInSubsetError, Refused
from tools.c_translator.names import BUILT_IN, fields_of, is_struct
from tools.c_translator.values import AND, CONDITION, EQUAL, OR, ORDER, POSTFIX, PRODUCT, SUM, UNARY, Value

if TYPE_CHECKING:
    from tools.c_translator.translate import Translation

T = TypeVar("T")

OPERATORS: dict[type[ast.AST], tuple[str, int]] = {
    ast.Or: ("||", OR),
    ast.And: ("&&", AND),
    ast.Eq: ("==", EQUAL),
    ast.NotEq: ("!=", EQUAL),
    ast.Lt: ("<", ORDER),
    ast.LtE: ("<=", ORDER),
    ast.Gt: (">", ORDER),
    ast.GtE: (">=", ORDER),
    ast.Add: ("+", SUM),
    ast.Sub: ("-", SUM),
    ast.Mult: ("*", PRODUCT),
    ast.Div: ("/", PRODUCT),
}


class Expressions:
    """Translator of a function's expressions, with a method for each kind of node."""

    def __init__(self, translation: Translation, function: Callable[..., Any]) -> None:
        self.translation = translation
        self.file = Path(inspect.getsourcefile(function) or "?").name
        self.outside = ChainMap(function.__globals__, vars(builtins))
        self.locals: dict[str, Value] = {}
        self.stores: Counter[str] = Counter()

    def visit(self, node: ast.AST) -> Any:
        """Return the translation of a node. Raises NotInSubsetError with file and line if the node is refused."""
        method = getattr(self, f"_{type(node).__name__}", None)
        try:
            if method is None:
                raise Refused
            return method(node)
        except Refused as reason:
            what = str(reason) or f"{type(node).__name__} `{ast.unparse(node)}`"
            line = getattr(node, "lineno", 0)
            raise NotInSubsetError(f"{self.file}:{line}: {what}") from None

    def static(self, node: ast.AST) -> Any:
        """Return the value of a name or attribute outside of the function, None if it has none."""
        match node:
            case ast.Name(id=name) if name not in self.locals and name not in self.stores:
                return self.outside.get(name)
            case ast.Attribute(value=base, attr=name):
                return getattr(self.static(base), name, None)
        return None

    def converted(self, value: Value, kind: Any, precedence: int = 0) -> str:
        """Return a value's text where a type is expected; C itself converts an int to a float. Raises Refused."""
        if value.type != kind and (value.type, kind) != (int, float):
            raise Refused(f"{value.type} where {kind} is needed: {value.text}")
        return value.within(precedence)

    def truth(self, node: ast.AST, precedence: int = 0) -> str:
        """Return the text of an expression that must be a bool. Raises Refused."""
        value = self.visit(node)
        if value.type is not bool:
            raise Refused(f"`{ast.unparse(node)}` is no bool")
        return str(value.within(precedence))

    def _number(self, node: ast.AST) -> Value:
        value: Value = self.visit(node)
        if value.type not in (float, int):
            raise Refused(f"`{ast.unparse(node)}` is no number")
        return value

    def _Constant(self, node: ast.Constant) -> Value:
        return self.translation.constant(node.value, "")

    def _Name(self, node: ast.Name) -> Value:
        if node.id in self.locals:
            return self.locals[node.id]
        value = self.static(node)
        if value is None:
            raise Refused(f"{node.id} has no value here")
        return self.translation.constant(value, node.id)

    def _Attribute(self, node: ast.Attribute) -> Value:
        value = self.static(node)
        if value is not None:
            return self.translation.constant(value, node.attr)
        members: dict[str, Value] = self.visit(node.value).members()
        if node.attr not in members:
            raise Refused
        return members[node.attr]

    def _Tuple(self, node: ast.Tuple) -> Value:
        values = [self.visit(element) for element in node.elts]
        return self._struct(types.GenericAlias(tuple, tuple(v.type for v in values)), values)

    def _struct(self, kind: Any, values: list[Value]) -> Value:
        kinds = fields_of(kind).values()
        texts = [self.converted(v, k) for k, v in matched(kinds, values)]
        return Value(f"({self.translation.type(kind)}){{{', '.join(texts)}}}", kind)

    def _UnaryOp(self, node: ast.UnaryOp) -> Value:
        if isinstance(node.op, ast.Not):
            return Value(f"!{self.truth(node.operand, POSTFIX)}", bool, UNARY)
        if not isinstance(node.op, ast.USub):
            raise Refused
        value = self._number(node.operand)
        return Value(f"-{value.within(POSTFIX)}", value.type, UNARY)

    def _BinOp(self, node: ast.BinOp) -> Value:
        if type(node.op) not in OPERATORS:
            raise Refused
        sign, own = OPERATORS[type(node.op)]
        left, right = self._number(node.left), self._number(node.right)
        if left.type is right.type is int:
            raise Refused(f"arithmetic of two ints: `{ast.unparse(node)}`")
        return Value(f"{left.within(own)} {sign} {right.within(own + 1)}", float, own)

    def _BoolOp(self, node: ast.BoolOp) -> Value:
        sign, own = OPERATORS[type(node.op)]
        return Value(f" {sign} ".join(self.truth(v, EQUAL) for v in node.values), bool, own)

    def _Compare(self, node: ast.Compare) -> Value:
        if any(type(op) not in OPERATORS for op in node.ops):
            raise Refused
        parts = []
        operands = [self.visit(operand) for operand in (node.left, *node.comparators)]
        for left, op, right in zip(operands[:-1], node.ops, operands[1:], strict=True):
            if is_struct(left.type) or is_struct(right.type):
                raise Refused
            sign, own = OPERATORS[type(op)]
            parts.append(f"{left.within(SUM)} {sign} {right.within(SUM)}")
        return Value(" && ".join(parts), bool, own if len(parts) == 1 else AND)

    def _IfExp(self, node: ast.IfExp) -> Value:
        test, yes, no = self.truth(node.test, OR), self.visit(node.body), self.visit(node.orelse)
        texts = yes.within(OR), self.converted(no, yes.type, OR)
        return Value(f"{test} ? {texts[0]} : {texts[1]}", yes.type, CONDITION)

    def _Call(self, node: ast.Call) -> Value:
        function = self.static(node.func)
        if node.keywords:
            raise Refused
        if inspect.isfunction(function):
            return self._call(function, [self.visit(argument) for argument in node.args])
        if is_struct(function):
            return self._struct(function, [self.visit(argument) for argument in node.args])
        name = BUILT_IN.get((function, len(node.args)))
        if name is None:
            raise Refused
        texts = [self.converted(self.visit(argument), float) for argument in node.args]
        return Value(f"{name}({', '.join(texts)})", float)

    def _call(self, function: Callable[..., Any], values: list[Value]) -> Value:
        name = self.translation.function(function)
        *kinds, result = typing.get_type_hints(function).values()
        texts = []
        for kind, value in matched(kinds, values):
            text = self.converted(value, kind)
            texts.append(value.address() if is_struct(kind) else text)
        return Value(f"{name}({', '.join(texts)})", result)


def matched(kinds: Collection[T], values: list[Value]) -> Iterator[tuple[T, Value]]:
    """Return (target, value) pairs; a target is a value's required type or its new name. Raises Refused."""
    if len(values) != len(kinds):
        raise Refused(f"{len(values)} values where {len(kinds)} are needed")
    return zip(kinds, values, strict=True)
