"""The exception tree: every error crashrate raises on purpose is a ``CrashrateError``."""


class CrashrateError(Exception):
    """Base of all errors raised on purpose; the command line turns it into exit code 1."""


class InvalidInputError(CrashrateError, ValueError):
    """A value given by the user is not what was expected."""


class MissingExtraError(CrashrateError, ImportError):
    """Something was asked for that needs an extra which is not installed."""


class EventsError(InvalidInputError):
    """A table of events has a missing column, a bad cell or a row outside the bounds."""


class ScenarioError(InvalidInputError):
    """A scenario file says something unknown, or lacks something needed."""


class ExpressionError(InvalidInputError):
    """The text of a derived quantity is not safe arithmetic on known names."""


class CallOrderError(CrashrateError, RuntimeError):
    """Methods were called in the wrong order, such as ``tell`` before ``ask``."""


class NumericalError(CrashrateError, ArithmeticError):
    """A computation lost its accuracy and says so instead of returning a number."""


class SimulationError(CrashrateError, RuntimeError):
    """The simulator failed, or returned something that is not one outcome per row."""


class StoreError(CrashrateError, OSError):
    """A run folder is missing, damaged, or belongs to another configuration."""
