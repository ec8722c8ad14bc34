"""Vehicles under test: what turns a situation into an outcome. Knows nothing of statistics."""

from crashrate.simulators.acc_aeb import AccAeb, AccAebResult
from crashrate.simulators.adapters import AccAebSimulator
from crashrate.simulators.base import Simulator, check_outcomes
from crashrate.simulators.python_function import PythonFunction

__all__ = [
    "AccAeb",
    "AccAebResult",
    "AccAebSimulator",
    "PythonFunction",
    "Simulator",
    "check_outcomes",
]
