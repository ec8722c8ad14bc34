"""Units of derived quantities: the unit algebra of ``inv_ttc / inv_range`` is 1/s over 1/m."""

import ast
import re
from collections.abc import Mapping
from fractions import Fraction

Powers = dict[str, Fraction]  # base unit to exponent; {} is a pure number

_FACTOR = re.compile(r"([A-Za-zµ°%]+)(?:\^|\*\*)?(-?\d+)?")
_SQUARES = str.maketrans("²³", "23")


def derived_unit(text: str, units: Mapping[str, str]) -> str:
    """The unit of the expression `text`, empty where it cannot be told.

    Parameters
    ----------
    text : str
        Arithmetic, as in the scenario file.
    units : mapping
        Name of each quantity in it to its unit, such as ``"m/s"``.
    """
    known = {name: powers_of(unit) for name, unit in units.items()}
    powers = _powers_of_node(ast.parse(text.strip(), mode="eval").body, known)
    return "" if powers is None else unit_text(powers)


def powers_of(unit: str) -> Powers | None:
    """``"m/s^2"`` as {"m": 1, "s": -2}; None for a text that is not of this kind."""
    powers: Powers = {}
    for position, part in enumerate(unit.translate(_SQUARES).split("/")):
        sign = 1 if position == 0 else -1
        for factor in re.split(r"[\s·*]+", part.strip("() ")):
            if factor in {"", "1"}:
                continue
            match = _FACTOR.fullmatch(factor)
            if match is None:
                return None
            powers = _plus(powers, {match[1]: Fraction(int(match[2] or 1))}, sign)
    return powers


def unit_text(powers: Powers) -> str:
    """{"m": 1, "s": -2} as ``"m/s²"``."""
    if any(p.denominator != 1 for p in powers.values()):
        return ""
    over = [_factor(b, int(p)) for b, p in powers.items() if p > 0]
    under = [_factor(b, -int(p)) for b, p in powers.items() if p < 0]
    if not under:
        return " ".join(over)
    return "/".join([" ".join(over) or "1", *under])


def _factor(base: str, power: int) -> str:
    return base if power == 1 else base + {2: "²", 3: "³"}.get(power, f"^{power}")


def _plus(left: Powers, right: Powers, sign: int | Fraction) -> Powers:
    total = dict(left)
    for base, power in right.items():
        total[base] = total.get(base, Fraction(0)) + sign * power
    return {base: power for base, power in total.items() if power}


def _powers_of_node(node: ast.expr, known: Mapping[str, Powers | None]) -> Powers | None:
    if isinstance(node, ast.Constant):
        return {}
    if isinstance(node, ast.Name):
        return known.get(node.id)
    if isinstance(node, ast.UnaryOp):
        return _powers_of_node(node.operand, known)
    if isinstance(node, ast.BinOp):
        return _powers_of_operation(node, known)
    return None


def _powers_of_operation(node: ast.BinOp, known: Mapping[str, Powers | None]) -> Powers | None:
    left, right = _powers_of_node(node.left, known), _powers_of_node(node.right, known)
    if left is None or right is None:
        return None
    if isinstance(node.op, ast.Mult | ast.Div):
        return _plus(left, right, 1 if isinstance(node.op, ast.Mult) else -1)
    if isinstance(node.op, ast.Pow):
        return _raised(left, node.right)
    return left if left == right else None


def _raised(powers: Powers, exponent: ast.expr) -> Powers | None:
    if not powers:
        return {}
    try:
        value = Fraction(str(ast.literal_eval(exponent)))
    except ValueError:
        return None
    return {base: power * value for base, power in powers.items() if value}
