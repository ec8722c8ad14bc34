"""Numbers as a person reads them: powers of ten, percentages, counts."""

import math
from collections.abc import Mapping
from typing import Any

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
MISSING = "not available"


def is_number(value: object) -> bool:
    """Whether `value` is a finite number; result.json holds None where there is none."""
    return isinstance(value, int | float) and math.isfinite(value)


def power_of_ten(value: float | None, digits: int = 2) -> str:
    """``2.0 × 10⁻⁶`` for small or large numbers, ``0.04`` for those near one."""
    if not is_number(value) or value is None:
        return MISSING
    if value == 0:
        return "0"
    if 0.001 <= abs(value) < 10_000:
        return f"{value:.{digits}g}"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa}\u00a0×\u00a010{superscript(int(exponent))}"  # does not break


def interval_text(interval: tuple[float, float]) -> str:
    """``1.8 × 10⁻⁶ to 2.2 × 10⁻⁶``."""
    return f"{power_of_ten(interval[0])} to {power_of_ten(interval[1])}"


def superscript(exponent: int) -> str:
    """The integer in raised digits."""
    return str(exponent).translate(_SUPERSCRIPTS)


def percent(value: float | None) -> str:
    """A share as a percentage with two digits."""
    if not is_number(value) or value is None:
        return MISSING
    return f"{float(f'{100 * value:.2g}'):,.12g}\u00a0%"


def count(value: float | None) -> str:
    """A count with thousands separated."""
    return f"{value:,.0f}" if is_number(value) and value is not None else MISSING


def plain(value: float | None, digits: int = 4) -> str:
    """A number with `digits` significant digits."""
    return f"{value:.{digits}g}" if is_number(value) and value is not None else MISSING


def number(record: Mapping[str, Any], key: str) -> float:
    """The number under `key`, NaN where the record holds None or nothing."""
    value = record.get(key)
    return float(value) if is_number(value) and value is not None else math.nan
