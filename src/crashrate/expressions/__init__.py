"""Safe arithmetic on named columns: what scenario files write for derived quantities.

The text is parsed with `ast`, never eval'd.
"""

from crashrate.expressions.expression import Expression
from crashrate.expressions.half_space import HalfSpace

__all__ = ["Expression", "HalfSpace"]
