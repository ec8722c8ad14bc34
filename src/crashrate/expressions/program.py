"""Programs for a stack machine: what the text of an expression is compiled to.

One interpreter runs a program on columns of numbers, which gives values, and on ratios of affine
forms, which gives half-spaces.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from crashrate.variables import FloatArray

Instruction = tuple[str, float]  # ("number", value), ("column", index) or (operation, arguments)
Program = tuple[Instruction, ...]
T = TypeVar("T")

ARITHMETIC: dict[str, Callable[..., Any]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "**": np.power,
    "negative": np.negative,
}
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "exp": np.exp,
    "log": np.log,
    "sqrt": np.sqrt,
    "abs": np.abs,
    "min": lambda *values: np.minimum.reduce(np.broadcast_arrays(*values)),
    "max": lambda *values: np.maximum.reduce(np.broadcast_arrays(*values)),
}
OPERATIONS = ARITHMETIC | FUNCTIONS
VARIADIC = ("min", "max")


def interpret(
    program: Sequence[Instruction],
    number: Callable[[float], T],
    column: Callable[[int], T],
    apply: Callable[[str, list[T]], T],
) -> T:
    """Run `program` on a stack of whatever `number`, `column` and `apply` make."""
    stack: list[T] = []
    for operation, argument in program:
        if operation == "number":
            stack.append(number(argument))
        elif operation == "column":
            stack.append(column(int(argument)))
        else:
            operands = stack[-int(argument) :]
            del stack[-int(argument) :]
            stack.append(apply(operation, operands))
    return stack.pop()


def evaluate(program: Sequence[Instruction], rows: FloatArray) -> FloatArray:
    """The values (n,) of `program` at `rows` (n, d); inf and NaN come without a warning."""
    with np.errstate(all="ignore"):
        values = interpret(program, _scalar, lambda column: rows[:, column], _apply)
    return np.array(np.broadcast_to(values, len(rows)), dtype=np.float64)


def _scalar(number: float) -> FloatArray:
    return np.asarray(number, dtype=np.float64)


def _apply(operation: str, operands: list[FloatArray]) -> FloatArray:
    values: FloatArray = OPERATIONS[operation](*operands)
    return values
