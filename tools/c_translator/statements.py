"""Translation of functions and their statements to C, with the declarations of their locals."""

from __future__ import annotations

import ast
import inspect
import textwrap
import typing
from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from tools.c_translator.errors import Refused
from tools.c_translator.expressions import OPERATORS, Expressions, matched
from tools.c_translator.names import c_name, is_struct
from tools.c_translator.values import SUM, Place, Value

if TYPE_CHECKING:
    from tools.c_translator.translate import Translation


class Function(Expressions):
    """Translator of one function, called `name` in C.

    A local is declared at its first assignment if that is in the block with all its mentions, else at the
    function's head.
    """

    def __init__(self, translation: Translation, function: Callable[..., Any], name: str) -> None:
        super().__init__(translation, function)
        lines, first = inspect.getsourcelines(function)
        tree = ast.parse(textwrap.dedent("".join(lines)))
        ast.increment_lineno(tree, first - 1)
        self.name = name
        self.hints = typing.get_type_hints(function)
        self.node = tree.body[0]
        self.stores = names_in(self.node, ast.Store)
        self.mentions: Counter[str] = Counter()  # by name, in the function
        self.inside: Counter[str] = Counter()  # by name, in the present block
        self.head: list[str] = []
        self.unpacked = 0

    def definition(self) -> str:
        """Return the function in C, with the first line of its docstring as a comment above."""
        return str(self.visit(self.node))

    def _FunctionDef(self, node: ast.FunctionDef) -> str:
        if node is not self.node:
            raise Refused
        if list(ast.iter_child_nodes(node.args)) != node.args.args:
            raise Refused("parameters other than plain ones")
        parameters = ", ".join(self._parameter(argument.arg) for argument in node.args.args)
        if "return" not in self.hints:
            raise Refused("a function without annotated result")
        result = self.translation.type(self.hints["return"])
        text = ast.get_docstring(node) or ""
        comment = f"/* {text.splitlines()[0].replace('*/', '* /')} */\n" if text else ""
        body = node.body[1:] if text else node.body
        self.mentions = names_in(body)
        lines = self._block(body)
        lines = [f"static {result} {self.name}({parameters or 'void'})", "{", *self.head, *lines]
        return comment + "\n".join([*lines, "}", ""])

    def _parameter(self, key: str) -> str:
        if key not in self.hints:
            raise Refused(f"parameter {key} without annotation")
        kind, name = self.hints[key], c_name(key)
        if not is_struct(kind):
            self.locals[key] = Value(name, kind, place=Place.VARIABLE)
            return f"{self.translation.type(kind)} {name}"
        if key in self.stores:
            raise Refused(f"a struct parameter that is assigned: {key}")
        self.locals[key] = Value(name, kind, place=Place.POINTER)
        return f"const {self.translation.type(kind)} *{name}"

    def _block(self, block: list[ast.stmt]) -> list[str]:
        outer, self.inside = self.inside, names_in(block)
        lines = [f"    {line}" for statement in block for line in self.visit(statement)]
        self.inside = outer
        return lines

    def _Return(self, node: ast.Return) -> list[str]:
        if node.value is None:
            raise Refused
        return [f"return {self.converted(self.visit(node.value), self.hints['return'])};"]

    def _Break(self, node: ast.Break) -> list[str]:
        return ["break;"]

    def _If(self, node: ast.If) -> list[str]:
        lines = [f"if ({self.truth(node.test)}) {{", *self._block(node.body)]
        if node.orelse:
            lines += ["} else {", *self._block(node.orelse)]
        return [*lines, "}"]

    def _For(self, node: ast.For) -> list[str]:
        match node:
            case ast.For(ast.Name(key), ast.Call(func, [_, *_] as bounds, []), orelse=[]) if (
                self.static(func) is range
            ):
                start, stop, by = self._range(bounds)
            case _:
                raise Refused("a for that does not count one name over range(...)")
        if key in self.locals or self.stores[key] != 1:
            raise Refused(f"{key} is assigned outside of its loop's head")
        name, compared, count = c_name(key), "<" if by == "1" else ">", "++" if by == "1" else "--"
        self.locals[key] = Value(name, int, place=Place.VARIABLE)
        head = f"for (int64_t {name} = {start}; {name} {compared} {stop}; {count}{name}) {{"
        lines = [head, *self._block(node.body), "}"]
        del self.locals[key]  # in C its scope ends with the loop
        return lines

    def _range(self, bounds: list[ast.expr]) -> list[str]:
        values = [self.visit(bound) for bound in bounds]
        if any(value.type is not int for value in values) or names_in(bounds) & self.stores:
            raise Refused("bounds of range that are no constant integers")
        texts = [value.within(SUM) for value in values]
        start, stop, by = ["0", *texts, "1"] if len(texts) == 1 else [*texts, "1"][:3]
        if by not in ("1", "-1"):
            raise Refused("a step of range other than 1 and -1")
        return [start, stop, by]

    def _Assign(self, node: ast.Assign) -> list[str]:
        match node.targets:
            case [ast.Name(key)]:
                return [self._store(key, self.visit(node.value))]
            case [ast.Tuple(names)] if all(isinstance(name, ast.Name) for name in names):
                keys = [ast.unparse(name) for name in names]
                lines, values = self._several(node.value, keys)
                return lines + [self._store(k, v) for k, v in matched(keys, values) if k != "_"]
        raise Refused

    def _several(self, source: ast.expr, keys: list[str]) -> tuple[list[str], list[Value]]:
        if isinstance(source, ast.Tuple) and not names_in(source) & Counter(keys):
            return [], [self.visit(element) for element in source.elts]
        lines, whole = [], self.visit(source)
        if whole.place < Place.CONSTANT:
            self.unpacked += 1
            name, kind = f"unpacked{self.unpacked}", self.translation.type(whole.type)
            lines = [f"const {kind} {name} = {whole.within(0)};"]
            whole = Value(name, whole.type, place=Place.CONSTANT)
        return lines, list(whole.members().values())

    def _AugAssign(self, node: ast.AugAssign) -> list[str]:
        if not isinstance(node.target, ast.Name):
            raise Refused
        whole = ast.copy_location(ast.BinOp(node.target, node.op, node.value), node)
        self.converted(self.visit(whole), self.visit(node.target).type)
        sign, value = OPERATORS[type(node.op)][0], self.visit(node.value)
        return [f"{c_name(node.target.id)} {sign}= {value.within(0)};"]

    def _store(self, key: str, value: Value) -> str:
        name, kind, text = c_name(key), self.translation.type(value.type), value.within(0)
        if key in self.locals:
            return f"{name} = {self.converted(value, self.locals[key].type)};"
        self.locals[key] = Value(name, value.type, place=Place.VARIABLE)
        if self.inside[key] != self.mentions[key]:
            self.head.append(f"    {kind} {name};")
            return f"{name} = {text};"
        if self.stores[key] != 1:
            return f"{kind} {name} = {text};"
        if is_struct(value.type) and value.place >= Place.CONSTANT:
            self.locals[key] = Value(name, value.type, place=Place.POINTER)
            return f"const {kind} *{name} = {value.address()};"
        self.locals[key] = Value(name, value.type, place=Place.CONSTANT)
        return f"const {kind} {name} = {text};"


def names_in(nodes: ast.AST | list[Any], context: type[ast.expr_context] = ast.expr_context) -> Counter[str]:
    """Return how often each name is mentioned in a piece of source, in one context or in all."""
    roots = nodes if isinstance(nodes, list) else [nodes]
    return Counter(
        node.id
        for root in roots
        for node in ast.walk(root)
        if isinstance(node, ast.Name) and isinstance(node.ctx, context)
    )
