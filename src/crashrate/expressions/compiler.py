"""From text to program; everything that is not arithmetic on known names is refused."""

import ast
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from crashrate.errors import ExpressionError
from crashrate.expressions.program import FUNCTIONS, VARIADIC, Instruction, Program, evaluate
from crashrate.variables import nearest

MAX_CHARACTERS = 1000
MAX_DEPTH = 50
MAX_INSTRUCTIONS = 2000  # derived quantities are written into each other: a*a of a*a of ...
MAX_EXPONENT = 100.0

_BINARY: dict[type[ast.operator], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Pow: "**",
}


def compile_text(text: str, names: tuple[str, ...], definitions: Mapping[str, Program]) -> Program:
    """The program of `text` on the columns `names`, with `definitions` written in by name.

    Raises
    ------
    ExpressionError
        If the text is anything but arithmetic; the message quotes it and the part refused.
    """
    tree, source = _parse(text)
    return tuple(_Compiler(source, names, definitions).compile(tree))


def _parse(text: str) -> tuple[ast.expr, str]:
    """The syntax tree of `text` and the one-line source that it was read from."""
    if not isinstance(text, str):
        raise ExpressionError(
            f"expected an expression as text, such as '1 / inv_range', got {text!r}."
        )
    source = " ".join(text.split())
    if not source or len(source) > MAX_CHARACTERS:
        raise ExpressionError(
            f"expression {source[:40]!r}: expected 1 to {MAX_CHARACTERS} characters, "
            f"got {len(source)}."
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # '1if 2' warns before it fails
            return ast.parse(source, mode="eval").body, source
    except SyntaxError as error:
        rest = source[error.offset - 1 :] if error.offset else ""
        where = f"at {rest!r}" if rest else "it ends too early"
        raise ExpressionError(
            f"expression {source!r}: not arithmetic: {where} ({error.msg})."
        ) from None
    except (ValueError, RecursionError, MemoryError) as error:  # a zero byte; nested too deep
        raise ExpressionError(f"expression {source[:40]!r}: cannot be read ({error}).") from None


@dataclass(frozen=True)
class _Compiler:
    """From syntax tree to program; everything that is not listed here is refused."""

    source: str
    names: tuple[str, ...]
    definitions: Mapping[str, Program]

    def compile(self, node: ast.expr, depth: int = 0) -> list[Instruction]:
        if depth > MAX_DEPTH:
            self._refuse(node, f"nested deeper than {MAX_DEPTH} levels")
        match node:
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                program = [("number", self._number(node, value))]
            case ast.Name(id=name):
                program = self._name(name)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                program = [*self.compile(operand, depth + 1), ("negative", 1)]
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                program = self.compile(operand, depth + 1)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
                program = [*self.compile(left, depth + 1), *self.compile(right, depth + 1)]
                program.append((_BINARY[type(op)], 2))
                self._check_exponent(op, right, depth)
            case ast.Call(func=ast.Name(id=function), args=arguments, keywords=[]):
                program = self._call(node, function, arguments, depth)
            case _:
                self._refuse(node, "only arithmetic on numbers and names is allowed")
        if len(program) > MAX_INSTRUCTIONS:
            self._refuse(node, f"longer than {MAX_INSTRUCTIONS} operations once written out")
        return program

    def _number(self, node: ast.expr, value: float) -> float:
        try:
            number = float(value)
        except OverflowError:
            number = np.inf
        if not np.isfinite(number):
            self._refuse(node, "too large for a number")
        return number

    def _name(self, name: str) -> list[Instruction]:
        if name in self.names:
            return [("column", self.names.index(name))]
        if name in self.definitions:
            return list(self.definitions[name])
        raise ExpressionError(
            f"expression {self.source!r}: unknown name {name!r}"
            f"{nearest(name, [*self.names, *self.definitions])}."
        )

    def _call(
        self, node: ast.expr, function: str, arguments: list[ast.expr], depth: int
    ) -> list[Instruction]:
        if function not in FUNCTIONS:
            raise ExpressionError(
                f"expression {self.source!r}: unknown function {function!r}"
                f"{nearest(function, list(FUNCTIONS))}."
            )
        n = len(arguments)
        if (n < 2) if function in VARIADIC else (n != 1):
            wanted = "two or more arguments" if function in VARIADIC else "one argument"
            self._refuse(node, f"{function} takes {wanted}, got {n}")
        program = [step for argument in arguments for step in self.compile(argument, depth + 1)]
        return [*program, (function, n)]

    def _check_exponent(self, op: ast.operator, node: ast.expr, depth: int) -> None:
        if not isinstance(op, ast.Pow):
            return
        program = self.compile(node, depth + 1)
        if any(operation == "column" for operation, _ in program):
            self._refuse(node, "an exponent must be a constant")
        value = evaluate(program, np.empty((1, 0)))[0]
        if not abs(value) <= MAX_EXPONENT:  # NaN is refused too
            self._refuse(node, f"an exponent must be at most {MAX_EXPONENT:g} in size")

    def _refuse(self, node: ast.expr, reason: str) -> NoReturn:
        part = ast.get_source_segment(self.source, node) or self.source
        raise ExpressionError(
            f"expression {self.source!r}: {part!r} is refused: {reason}. Known are + - * / **, "
            f"{', '.join(FUNCTIONS)} and the names "
            f"{', '.join([*self.names, *self.definitions])}."
        )
