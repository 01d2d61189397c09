"""Readable C99 of functions in the plant's subset of Python: what a C programmer would have written.

    NamedTuple, tuple       struct; as an argument `const T *`, as a result by value
    float, int, bool        double, int64_t, bool
    function                static function, named module_function
    module constant         its value

Statements: assignment, if, while, for over range, return, break, continue, pass. Functions call each other,
math's functions, min, max, abs, float and int. All else is refused with its file and line.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import math
import textwrap
import types
import typing
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

Block = list[ast.stmt]

SCALARS: dict[Any, str] = {float: "double", int: "int64_t", bool: "bool"}
MATH = {
    math.sqrt: "sqrt",
    math.exp: "exp",
    math.log: "log",
    math.sin: "sin",
    math.cos: "cos",
    math.tan: "tan",
    math.asin: "asin",
    math.acos: "acos",
    math.atan: "atan",
    math.atan2: "atan2",
    math.hypot: "hypot",
    math.copysign: "copysign",
    math.fabs: "fabs",
}
TESTS = {math.isnan: "isnan", math.isinf: "isinf", math.isfinite: "isfinite"}
C_WORDS = """
    auto bool case char const default do double enum extern float goto inline int long register
    restrict short signed sizeof static struct switch typedef union unsigned void volatile
"""
# Names that a Python local may have and a C local may not.
RESERVED = {*C_WORDS.split(), *MATH.values(), *TESTS.values(), "min_of", "max_of"}

CONDITION, OR, AND, EQUAL, ORDER, SUM, PRODUCT, UNARY, POSTFIX = range(9)
ARITHMETIC: dict[type[ast.operator], tuple[str, int]] = {
    ast.Add: ("+", SUM),
    ast.Sub: ("-", SUM),
    ast.Mult: ("*", PRODUCT),
    ast.Div: ("/", PRODUCT),
}
COMPARISONS: dict[type[ast.cmpop], tuple[str, int]] = {
    ast.Lt: ("<", ORDER),
    ast.LtE: ("<=", ORDER),
    ast.Gt: (">", ORDER),
    ast.GtE: (">=", ORDER),
    ast.Eq: ("==", EQUAL),
    ast.NotEq: ("!=", EQUAL),
}
# Of two that are equal or unordered Python's min and max give the first, unlike fmin and fmax.
HEADER = """\
#include <math.h>
#include <stdbool.h>
#include <stdint.h>

static inline double min_of(double a, double b) { return b < a ? b : a; }
static inline double max_of(double a, double b) { return b > a ? b : a; }
"""
WIDTH = 100
_MISSING = object()


class NotInSubsetError(Exception):
    """A construct without a translation."""


@dataclass(frozen=True)
class Value:
    """A C expression of a Python type."""

    text: str
    type: Any
    precedence: int = POSTFIX
    pointer: bool = False  # the text is a pointer to the value
    place: bool = False  # the value has an address
    fixed: bool = False  # what it is read from does not change during the call

    def within(self, precedence: int) -> str:
        """The text as an operand of an operator that binds so tightly."""
        text = f"*{self.text}" if self.pointer else self.text
        own = UNARY if self.pointer else self.precedence
        return f"({text})" if own < precedence else text

    def field(self, name: str, kind: Any) -> Value:
        """A member of a struct."""
        text = f"{self.text}->{name}" if self.pointer else f"{self.within(POSTFIX)}.{name}"
        return Value(text, kind, place=self.place or self.pointer, fixed=self.fixed)

    def address(self) -> str:
        """A pointer to the value, to a temporary one if need be."""
        if self.pointer:
            return self.text
        if self.place or self.text.startswith(f"({type_name(self.type)}){{"):
            return f"&{self.text}"
        return f"({type_name(self.type)}[1]){{{self.text}}}"


def is_struct(kind: Any) -> bool:
    """Whether values of a type are structs in C."""
    return typing.get_origin(kind) is tuple or (
        isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields")
    )


def fields_of(kind: Any) -> dict[str, Any]:
    """Names and types of a struct's members."""
    if typing.get_origin(kind) is tuple:
        return {f"item{k}": item for k, item in enumerate(typing.get_args(kind))}
    hints = typing.get_type_hints(kind)
    return {name: hints[name] for name in kind._fields}


def type_name(kind: Any) -> str:
    """A type's name in C."""
    if typing.get_origin(kind) is tuple:
        return "_".join(["Tuple", *map(type_name, typing.get_args(kind))])
    return SCALARS[kind] if kind in SCALARS else str(kind.__name__)


def c_name(name: str) -> str:
    """A local's name in C."""
    return f"{name}_" if name in RESERVED else name


def translate(entry: Callable[..., Any]) -> str:
    """C99 source of a function and of all that it calls."""
    translation = Translation()
    translation.function(entry)
    parts = [HEADER, *translation.structs.values()]
    parts += translation.constants.values()
    source = "\n".join([*parts, *translation.functions.values()])
    return "".join(f"{line}\n" for long in source.splitlines() for line in wrapped(long))


def wrapped(line: str) -> list[str]:
    """A line of C in lines of the usual length."""
    if len(line) <= WIDTH:
        return [line]
    indent = " " * (len(line) - len(line.lstrip()) + 8)
    return textwrap.wrap(
        line, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def function_name(function: Callable[..., Any]) -> str:
    """A function's name in C."""
    return f"{function.__module__.rpartition('.')[2]}_{function.__name__}"


class Translation:
    """All definitions so far, callees before callers."""

    def __init__(self) -> None:
        self.structs: dict[str, str] = {}
        self.constants: dict[str, str] = {}
        self.functions: dict[str, str] = {}
        self._known: dict[str, Any] = {}

    def _is_new(self, name: str, thing: Any) -> bool:
        if self._known.setdefault(name, thing) != thing:
            raise NotInSubsetError(f"two different things are called {name}")
        return name not in self.structs | self.constants | self.functions

    def type(self, kind: Any) -> str:
        """A type's name in C; its definition, and those it needs, are written at its first use."""
        if kind not in SCALARS and not is_struct(kind):
            raise NotInSubsetError(f"values of type {kind}")
        name = type_name(kind)
        if is_struct(kind) and self._is_new(name, kind):
            members = [f"    {self.type(t)} {c_name(n)};\n" for n, t in fields_of(kind).items()]
            self.structs[name] = f"typedef struct {{\n{''.join(members)}}} {name};\n"
        return name

    def constant(self, value: Any, name: str) -> Value:
        """A module's constant; a NamedTuple becomes a C constant called `name`."""
        if isinstance(value, bool):
            return Value("true" if value else "false", bool, fixed=True)
        if isinstance(value, int | float):
            special = {"inf": "INFINITY", "-inf": "-INFINITY", "nan": "NAN"}
            text = special.get(repr(value), repr(value))
            sign = UNARY if text.startswith("-") else POSTFIX
            return Value(text, type(value), sign, fixed=True)
        if not is_struct(type(value)):
            raise NotInSubsetError(f"a constant of type {type(value).__name__}")
        kind = self.type(type(value))
        if self._is_new(name, value):
            members = self._initialiser(value)
            self.constants[name] = f"static const {kind} {name} = {members};\n"
        return Value(name, type(value), place=True, fixed=True)

    def _initialiser(self, value: Any) -> str:
        if isinstance(value, tuple):
            return f"{{{', '.join(map(self._initialiser, value))}}}"
        return self.constant(value, "").text

    def function(self, function: Callable[..., Any]) -> str:
        """A function's name in C; its definition is written at its first use."""
        name = function_name(function)
        if self._is_new(name, function):
            self.functions[name] = ""
            definition = _Function(self, function).definition()
            del self.functions[name]  # callees stand before it
            self.functions[name] = definition
        elif not self.functions[name]:
            raise NotInSubsetError("a recursive call")
        return name


class _Function:
    """The translation of one function."""

    def __init__(self, translation: Translation, function: Callable[..., Any]) -> None:
        lines, first = inspect.getsourcelines(function)
        tree = ast.parse(textwrap.dedent("".join(lines)))
        ast.increment_lineno(tree, first - 1)
        node = tree.body[0]
        self.file = Path(inspect.getsourcefile(function) or "?").name
        if not isinstance(node, ast.FunctionDef):
            self.refuse(node, "not a function")
        self.translation = translation
        self.function = function
        self.node: ast.FunctionDef = node
        self.hints = typing.get_type_hints(function)
        self.locals: dict[str, Value] = {}
        self.stores = Counter(
            child.id
            for child in ast.walk(node)
            if isinstance(child, ast.Name) and isinstance(child.ctx, ast.Store)
        )
        self.counters = Counter(
            child.target.id
            for child in ast.walk(node)
            if isinstance(child, ast.For) and isinstance(child.target, ast.Name)
        )
        self.owners: dict[str, int] = {}
        self.in_place: set[str] = set()
        self.declared: set[str] = set()
        self.unpacked = 0

    def refuse(self, node: ast.AST, reason: str = "") -> NoReturn:
        """Raise the error for a construct."""
        what = reason or f"{type(node).__name__} `{ast.unparse(node)}`"
        raise NotInSubsetError(f"{self.file}:{getattr(node, 'lineno', 0)}: {what}")

    def type(self, kind: Any, node: ast.AST) -> str:
        """A type's name in C."""
        try:
            return self.translation.type(kind)
        except NotInSubsetError as error:
            self.refuse(node, str(error))

    def definition(self) -> str:
        """The function in C, under the first line of its docstring."""
        arguments = self.node.args
        if arguments.vararg or arguments.kwarg or arguments.kwonlyargs or arguments.posonlyargs:
            self.refuse(self.node, "parameters other than plain ones")
        parameters = [self.parameter(argument) for argument in arguments.args]
        self.find_owners()
        body = self.block(self.node.body)
        result = self.type(self.result(), self.node)
        head = f"static {result} {function_name(self.function)}({', '.join(parameters) or 'void'})"
        lines = (ast.get_docstring(self.node) or "").partition("\n")[0].replace("*/", "* /")
        comment = f"/* {lines} */\n" if lines else ""
        return f"{comment}{head}\n{{\n{textwrap.indent(chr(10).join(body), '    ')}\n}}\n"

    def result(self) -> Any:
        """The type of the function's result."""
        if "return" not in self.hints:
            self.refuse(self.node, "a function without annotated result")
        return self.hints["return"]

    def parameter(self, argument: ast.arg) -> str:
        """A parameter's declaration."""
        if argument.arg not in self.hints:
            self.refuse(argument, f"parameter {argument.arg} without annotation")
        kind, name = self.hints[argument.arg], c_name(argument.arg)
        fixed = argument.arg not in self.stores
        struct = is_struct(kind)
        if struct and not fixed:
            self.refuse(argument, f"a struct parameter that is assigned: {argument.arg}")
        self.locals[argument.arg] = Value(name, kind, pointer=struct, place=True, fixed=fixed)
        self.declared.add(argument.arg)
        return (
            f"{'const ' if struct else ''}{self.type(kind, argument)} {'*' if struct else ''}{name}"
        )

    # Where locals are declared: at the first assignment if that comes before all other mentions in the
    # innermost block with all mentions, else just before that, outside of loops that could carry the value.

    def find_owners(self) -> None:
        """Find each local's block."""
        mentions: dict[str, list[list[tuple[Block, bool]]]] = {}
        for name, path in self.mentions(self.node.body, [(self.node.body, False)]):
            if name in self.stores and name not in self.locals and name not in self.counters:
                mentions.setdefault(name, []).append(path)
        for name, paths in mentions.items():
            depth = 0
            while all(len(path) > depth and path[depth][0] is paths[0][depth][0] for path in paths):
                depth += 1
            chain = paths[0][:depth]
            first = next(s for s in chain[-1][0] if name in names_in(s))
            if isinstance(first, ast.Assign | ast.AnnAssign):
                self.in_place.add(name)
            else:
                loops = [k for k, (_, loop) in enumerate(chain) if loop]
                chain = chain[: loops[0]] if loops else chain
            self.owners[name] = id(chain[-1][0])

    def mentions(
        self, block: Block, path: list[tuple[Block, bool]]
    ) -> Iterator[tuple[str, list[tuple[Block, bool]]]]:
        """All names in a block, each with the blocks around it and whether these are loops."""
        for statement in block:
            bodies = [getattr(statement, part, []) for part in ("body", "orelse")]
            loop = isinstance(statement, ast.For | ast.While)
            inner = {id(child) for body in bodies for child in body}
            for child in ast.iter_child_nodes(statement):
                if id(child) not in inner:
                    yield from ((name, path) for name in names_in(child))
            for body in bodies:
                yield from self.mentions(body, [*path, (body, loop)])

    # Statements.

    def block(self, block: Block) -> list[str]:
        """A block's lines; declarations of names still without type are completed afterwards."""
        lines: list[str] = []
        for statement in block:
            early = [
                name
                for name in sorted(names_in(statement))
                if self.owners.get(name) == id(block) and name not in self.declared | self.in_place
            ]
            self.declared.update(early)
            method = getattr(self, f"do_{type(statement).__name__}", None)
            if method is None:
                self.refuse(statement)
            inner = method(statement)
            lines += [
                f"{self.type(self.locals[name].type, statement)} {c_name(name)};" for name in early
            ]
            lines += inner
        return lines

    def do_Expr(self, node: ast.Expr) -> list[str]:
        """A docstring, nothing else."""
        if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            return []
        self.refuse(node)

    def do_Pass(self, node: ast.Pass) -> list[str]:
        """Nothing."""
        return [";"]

    def do_Break(self, node: ast.Break) -> list[str]:
        """Break."""
        return ["break;"]

    def do_Continue(self, node: ast.Continue) -> list[str]:
        """Continue."""
        return ["continue;"]

    def do_Return(self, node: ast.Return) -> list[str]:
        """Return."""
        if node.value is None:
            self.refuse(node, "a return without a value")
        return [f"return {self.converted(self.value(node.value), self.result(), node)};"]

    def do_Assign(self, node: ast.Assign) -> list[str]:
        """Assignment to one name or to a tuple of names."""
        if len(node.targets) != 1:
            self.refuse(node, "more than one target")
        return self.assign(node.targets[0], node.value)

    def do_AnnAssign(self, node: ast.AnnAssign) -> list[str]:
        """Annotated assignment; the type is inferred all the same."""
        if node.value is None:
            self.refuse(node)
        return self.assign(node.target, node.value)

    def do_AugAssign(self, node: ast.AugAssign) -> list[str]:
        """Assignment with an operator."""
        if not isinstance(node.target, ast.Name):
            self.refuse(node)
        old = ast.copy_location(ast.Name(node.target.id, ast.Load()), node.target)
        result = self.value(ast.copy_location(ast.BinOp(old, node.op, node.value), node))
        name = c_name(node.target.id)
        self.converted(result, self.locals[node.target.id].type, node)
        return [f"{name} {ARITHMETIC[type(node.op)][0]}= {self.value(node.value).within(0)};"]

    def assign(self, target: ast.expr, source: ast.expr) -> list[str]:
        """Assignment of one value or of several."""
        if isinstance(target, ast.Name):
            return [self.store(target, self.value(source))]
        if not isinstance(target, ast.Tuple):
            self.refuse(target)
        names = [t for t in target.elts if isinstance(t, ast.Name)]
        if len(names) != len(target.elts):
            self.refuse(target)
        lines: list[str] = []
        if isinstance(source, ast.Tuple) and not names_in(source) & names_in(target):
            values = [self.value(element) for element in source.elts]
        else:
            whole = self.value(source)
            if not is_struct(whole.type):
                self.refuse(source)
            if not whole.pointer and not (whole.place and whole.fixed):
                self.unpacked += 1
                name = f"unpacked{self.unpacked}"
                lines = [f"const {type_name(whole.type)} {name} = {whole.within(0)};"]
                whole = Value(name, whole.type, place=True, fixed=True)
            values = [whole.field(c_name(n), t) for n, t in fields_of(whole.type).items()]
        if len(values) != len(names):
            self.refuse(target, "as many names as values are needed")
        pairs = zip(names, values, strict=True)
        return lines + [self.store(name, value) for name, value in pairs if name.id != "_"]

    def store(self, target: ast.Name, value: Value) -> str:
        """One assignment, with the declaration where it belongs here."""
        name, key = c_name(target.id), target.id
        kind = self.type(value.type, target)
        if key in self.declared:
            known = self.locals.setdefault(key, Value(name, value.type, place=True))
            return f"{name} = {self.converted(value, known.type, target)};"
        self.declared.add(key)
        once = self.stores[key] == 1
        if once and is_struct(value.type) and value.fixed and (value.pointer or value.place):
            self.locals[key] = Value(name, value.type, pointer=True, place=True, fixed=True)
            return f"const {kind} *{name} = {value.address()};"
        self.locals[key] = Value(name, value.type, place=True, fixed=once)
        return f"{'const ' if once else ''}{kind} {name} = {value.within(0)};"

    def do_If(self, node: ast.If) -> list[str]:
        """If, elif, else."""
        lines = [f"if ({self.truth(node.test).within(0)}) {{", *self.indented(node.body)]
        if not node.orelse:
            return [*lines, "}"]
        other = self.block(node.orelse)
        if isinstance(node.orelse[0], ast.If) and other[0].startswith("if ("):
            return [*lines, f"}} else {other[0]}", *other[1:]]
        return [*lines, "} else {", *(f"    {line}" for line in other), "}"]

    def do_While(self, node: ast.While) -> list[str]:
        """While."""
        if node.orelse:
            self.refuse(node, "else of a loop")
        test = self.truth(node.test).within(0)
        return [f"while ({test}) {{", *self.indented(node.body), "}"]

    def do_For(self, node: ast.For) -> list[str]:
        """Counting with range, whose bounds no statement of the function changes."""
        call, target = node.iter, node.target
        if node.orelse:
            self.refuse(node, "else of a loop")
        if not (
            isinstance(call, ast.Call)
            and self.static(call.func) is range
            and not call.keywords
            and isinstance(target, ast.Name)
        ):
            self.refuse(node, "a for that does not count one name over range(...)")
        own = self.counters[target.id] == self.stores[target.id] and target.id not in self.locals
        if target.id != "_" and not own:
            self.refuse(node, f"{target.id} is assigned outside of its loop's head")
        bounds = [self.value(argument) for argument in call.args]
        if any(bound.type is not int or not bound.fixed for bound in bounds):
            self.refuse(node, "bounds of range that are no constant integers")
        start = bounds[0].within(0) if len(bounds) > 1 else "0"
        stop = bounds[min(1, len(bounds) - 1)].within(SUM)
        by = int(bounds[2].text) if len(bounds) > 2 and bounds[2].text.lstrip("-").isdigit() else 1
        if by == 0 or (len(bounds) > 2 and bounds[2].text != str(by)):
            self.refuse(node, "a step of range that is no number")
        name = c_name(target.id)
        count = {1: f"++{name}", -1: f"--{name}"}.get(by, f"{name} += {by}")
        compared = f"{name} {'<' if by > 0 else '>'} {stop}"
        self.locals[target.id] = Value(name, int, place=True)
        body = self.indented(node.body)
        self.locals.pop(target.id, None)  # C's is gone after the loop
        return [f"for (int64_t {name} = {start}; {compared}; {count}) {{", *body, "}"]

    def indented(self, block: Block) -> list[str]:
        """A block's lines inside of braces."""
        return [f"    {line}" for line in self.block(block)]

    # Expressions.

    def value(self, node: ast.expr) -> Value:
        """An expression in C."""
        method = getattr(self, f"of_{type(node).__name__}", None)
        if method is None:
            self.refuse(node)
        value: Value = method(node)
        return value

    def truth(self, node: ast.expr) -> Value:
        """An expression that has to be a bool."""
        value = self.value(node)
        if value.type is not bool:
            self.refuse(node, f"`{ast.unparse(node)}` is no bool")
        return value

    def number(self, node: ast.expr) -> Value:
        """An expression that has to be a float or an int."""
        value = self.value(node)
        if value.type not in {float, int}:
            self.refuse(node, f"`{ast.unparse(node)}` is no number")
        return value

    def converted(self, value: Value, kind: Any, node: ast.AST, precedence: int = 0) -> str:
        """A value's text where a type is expected; C makes a float of an int by itself."""
        if value.type != kind and (value.type, kind) != (int, float):
            self.refuse(node, f"{value.type} where {kind} is needed in `{ast.unparse(node)}`")
        return value.within(precedence)

    def argument(self, value: Value, kind: Any, node: ast.AST) -> str:
        """A value as an argument of a function."""
        text = self.converted(value, kind, node)
        return value.address() if is_struct(kind) else text

    def static(self, node: ast.expr) -> Any:
        """What a name means outside of the function, or _MISSING."""
        if isinstance(node, ast.Name) and node.id not in {*self.locals, *self.stores}:
            scope = self.function.__globals__
            return scope.get(node.id, getattr(builtins, node.id, _MISSING))
        if isinstance(node, ast.Attribute):
            base = self.static(node.value)
            return _MISSING if base is _MISSING else getattr(base, node.attr, _MISSING)
        return _MISSING

    def constant(self, node: ast.expr, value: Any) -> Value:
        """A constant from outside of the function."""
        try:
            name = ast.unparse(node).rpartition(".")[2]
            return self.translation.constant(value, name)
        except NotInSubsetError as error:
            self.refuse(node, str(error))

    def of_Constant(self, node: ast.Constant) -> Value:
        """A number, True or False."""
        return self.constant(node, node.value)

    def of_Name(self, node: ast.Name) -> Value:
        """A local or a module's constant."""
        if node.id in self.locals:
            return self.locals[node.id]
        value = self.static(node)
        if value is _MISSING:
            self.refuse(node, f"{node.id} has no value here")
        return self.constant(node, value)

    def of_Attribute(self, node: ast.Attribute) -> Value:
        """A member or another module's constant."""
        value = self.static(node)
        if value is not _MISSING:
            return self.constant(node, value)
        base = self.value(node.value)
        if not is_struct(base.type) or node.attr not in fields_of(base.type):
            self.refuse(node)
        return base.field(c_name(node.attr), fields_of(base.type)[node.attr])

    def of_Subscript(self, node: ast.Subscript) -> Value:
        """A tuple's element."""
        base = self.value(node.value)
        index = node.slice.value if isinstance(node.slice, ast.Constant) else None
        members = list(fields_of(base.type).items()) if is_struct(base.type) else []
        if not isinstance(index, int) or not 0 <= index < len(members):
            self.refuse(node)
        return base.field(c_name(members[index][0]), members[index][1])

    def of_Tuple(self, node: ast.Tuple) -> Value:
        """A tuple."""
        values = [self.value(element) for element in node.elts]
        kind = types.GenericAlias(tuple, tuple(value.type for value in values))
        return self.literal(kind, values, node)

    def literal(self, kind: Any, values: list[Value], node: ast.AST) -> Value:
        """A struct of these values."""
        wanted = fields_of(kind).values()
        texts = [self.converted(v, t, node) for v, t in zip(values, wanted, strict=True)]
        return Value(f"({self.type(kind, node)}){{{', '.join(texts)}}}", kind)

    def of_UnaryOp(self, node: ast.UnaryOp) -> Value:
        """Sign or not."""
        if isinstance(node.op, ast.Not):
            return Value(f"!{self.truth(node.operand).within(POSTFIX)}", bool, UNARY)
        if not isinstance(node.op, ast.USub):
            self.refuse(node)
        value = self.number(node.operand)
        fixed = isinstance(node.operand, ast.Constant)
        return Value(f"-{value.within(POSTFIX)}", value.type, UNARY, fixed=fixed)

    def of_BinOp(self, node: ast.BinOp) -> Value:
        """Arithmetic, in the order in which Python does it."""
        if type(node.op) not in ARITHMETIC:
            self.refuse(node)
        sign, own = ARITHMETIC[type(node.op)]
        left, right = self.number(node.left), self.number(node.right)
        kind = int if left.type is right.type is int else float
        text = left.within(own)
        if isinstance(node.op, ast.Div) and kind is int:
            kind, text = float, f"(double){left.within(UNARY)}"
        return Value(f"{text} {sign} {right.within(own + 1)}", kind, own)

    def of_BoolOp(self, node: ast.BoolOp) -> Value:
        """And, or."""
        sign, own = ("&&", AND) if isinstance(node.op, ast.And) else ("||", OR)
        texts = [self.truth(value).within(EQUAL) for value in node.values]
        return Value(f" {sign} ".join(texts), bool, own)

    def of_Compare(self, node: ast.Compare) -> Value:
        """Comparisons, chained or with a set of constants."""
        if isinstance(node.ops[0], ast.In | ast.NotIn):
            return self.membership(node)
        operands = [node.left, *node.comparators]
        for middle in operands[1:-1]:
            self.need_simple(middle)
        parts = []
        for first, op, second in zip(operands[:-1], node.ops, operands[1:], strict=True):
            if type(op) not in COMPARISONS:
                self.refuse(node)
            sign, own = COMPARISONS[type(op)]
            left, right = self.value(first), self.value(second)
            if is_struct(left.type) or is_struct(right.type):
                self.refuse(node, f"comparison of structs in `{ast.unparse(node)}`")
            parts.append(Value(f"{left.within(SUM)} {sign} {right.within(SUM)}", bool, own))
        if len(parts) == 1:
            return parts[0]
        return Value(" && ".join(part.text for part in parts), bool, AND)

    def membership(self, node: ast.Compare) -> Value:
        """`x in {1, 2}` as comparisons."""
        container = node.comparators[0]
        if len(node.ops) != 1 or not isinstance(container, ast.Set | ast.Tuple):
            self.refuse(node)
        self.need_simple(node.left)
        left = self.number(node.left).within(SUM)
        same = isinstance(node.ops[0], ast.In)
        texts = [
            f"{left} {'==' if same else '!='} {self.number(element).within(SUM)}"
            for element in container.elts
        ]
        return Value(" || ".join(texts) if same else " && ".join(texts), bool, OR if same else AND)

    def need_simple(self, node: ast.expr) -> None:
        """Refuse what C would compute twice."""
        if not isinstance(node, ast.Name | ast.Attribute | ast.Constant):
            self.refuse(node, f"`{ast.unparse(node)}` is computed twice, give it a name")

    def of_IfExp(self, node: ast.IfExp) -> Value:
        """A conditional expression."""
        test = self.truth(node.test)
        yes, no = self.value(node.body), self.value(node.orelse)
        kind = float if {yes.type, no.type} == {int, float} else yes.type
        texts = [self.converted(branch, kind, node, CONDITION + 1) for branch in (yes, no)]
        return Value(f"{test.within(OR)} ? {texts[0]} : {texts[1]}", kind, CONDITION)

    def of_Call(self, node: ast.Call) -> Value:
        """A call of a function or of a NamedTuple's constructor, or a built-in one."""
        if any(isinstance(argument, ast.Starred) for argument in node.args):
            self.refuse(node)
        if isinstance(node.func, ast.Attribute) and node.func.attr == "_replace":
            return self.replaced(node, node.func.value)
        function = self.static(node.func)
        if inspect.isfunction(function):
            return self.call(node, function)
        if is_struct(function):
            names, defaults = function._fields, function._field_defaults
            return self.literal(function, self.arguments(node, names, defaults), node)
        if function in (min, max, abs, float, int) or function in MATH or function in TESTS:
            return self.built_in(node, function)
        self.refuse(node)

    def call(self, node: ast.Call, function: Callable[..., Any]) -> Value:
        """A call of a translated function."""
        parameters = inspect.signature(function).parameters
        defaults = {k: p.default for k, p in parameters.items() if p.default is not p.empty}
        values = self.arguments(node, tuple(parameters), defaults)
        try:
            name = self.translation.function(function)
        except NotInSubsetError as error:
            if str(error) == "a recursive call":
                self.refuse(node, f"{error} of {function.__name__}")
            raise
        hints = typing.get_type_hints(function)
        pairs = zip(values, parameters, strict=True)
        texts = [self.argument(value, hints[key], node) for value, key in pairs]
        return Value(f"{name}({', '.join(texts)})", hints["return"])

    def arguments(
        self, node: ast.Call, names: tuple[str, ...], defaults: dict[str, Any]
    ) -> list[Value]:
        """The arguments in the order of the parameters."""
        given = dict(zip(names, map(self.value, node.args), strict=False))
        for keyword in node.keywords:
            if keyword.arg not in names or keyword.arg in given:
                self.refuse(node)
            given[keyword.arg] = self.value(keyword.value)
        for name in names:
            if name not in given and name in defaults:
                given[name] = self.constant(ast.copy_location(ast.Name(name), node), defaults[name])
        if len(node.args) > len(names) or set(given) != set(names):
            self.refuse(node, f"wrong number of arguments in `{ast.unparse(node)}`")
        return [given[name] for name in names]

    def replaced(self, node: ast.Call, source: ast.expr) -> Value:
        """A NamedTuple with some members changed."""
        self.need_simple(source)
        old = self.value(source)
        changes = {keyword.arg: self.value(keyword.value) for keyword in node.keywords}
        if not is_struct(old.type) or node.args or not changes.keys() <= fields_of(old.type).keys():
            self.refuse(node)
        members = [changes.get(n, old.field(c_name(n), t)) for n, t in fields_of(old.type).items()]
        return self.literal(old.type, members, node)

    def built_in(self, node: ast.Call, function: Callable[..., Any]) -> Value:
        """Functions of Python's and of math."""
        if node.keywords or not node.args:
            self.refuse(node)
        values = [self.number(argument) for argument in node.args]
        texts = [value.within(0) for value in values]
        if function in MATH or function in TESTS:
            name = MATH.get(function) or TESTS[function]
            return Value(f"{name}({', '.join(texts)})", float if function in MATH else bool)
        if function in (min, max):
            if len(values) < 2 or any(value.type is not float for value in values):
                self.refuse(node, f"`{ast.unparse(node)}` of other than several floats")
            text = texts[0]
            for other in texts[1:]:
                text = f"{function.__name__}_of({text}, {other})"
            return Value(text, float)
        if len(values) != 1:
            self.refuse(node)
        value = values[0]
        if function is abs:
            return Value(f"{'fabs' if value.type is float else 'llabs'}({texts[0]})", value.type)
        kind: Any = function
        return replace(value, text=f"({SCALARS[kind]}){value.within(UNARY)}", type=kind,
                       precedence=UNARY, place=False)  # fmt: skip


def names_in(node: ast.AST) -> set[str]:
    """All names in a piece of source."""
    return {child.id for child in ast.walk(node) if isinstance(child, ast.Name)}
