"""A simulator that is a Python function of the user, given as ``module:function``."""

import hashlib
import importlib
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import numpy.typing as npt

from crashrate.errors import InvalidInputError, SimulationError
from crashrate.outcomes import Told
from crashrate.simulators.base import check_outcomes
from crashrate.simulators.own_files import own_files
from crashrate.variables import FloatArray, nearest


@dataclass(frozen=True)
class PythonFunction:
    """The function named by `target`, imported where it is first called; so it can be pickled.

    Parameters
    ----------
    target : str
        ``"module:function"``; the function takes rows (n, d) of the variables and returns (n,)
        outcomes: booleans, or the numbers 1, 0 and NaN (failed).
    folder : str, optional
        Where the module is looked for first: the folder of the scenario file.
    consequences : tuple of str
        Names of what the function tells beside the event: it then returns (n, 1 + K), or a mapping
        of these names, and one for the event, to arrays (n,).

    Raises
    ------
    InvalidInputError
        If `target` is not of that form.
    """

    target: str
    folder: str | None = None
    consequences: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        module, colon, function = self.target.partition(":")
        names = [*module.split("."), function]
        if not colon or not all(name.isidentifier() for name in names):
            raise InvalidInputError(
                f"simulator function {self.target!r}: expected 'module:function', such as "
                "'my_simulator:crashes' for the function crashes in my_simulator.py."
            )
        if self.folder is not None:
            object.__setattr__(self, "folder", str(Path(self.folder).resolve()))

    def load(self) -> Callable[[FloatArray], Told]:
        """Import the module and return the function: call it early to fail early.

        Raises
        ------
        InvalidInputError
            If there is no such module or function, or another module of that name came first.
        SimulationError
            If the module itself fails when it is imported.
        """
        name, _, attribute = self.target.partition(":")
        module = self._import(name)
        function = getattr(module, attribute, None)
        if not callable(function):
            known = [n for n, value in vars(module).items() if callable(value) and n[0] != "_"]
            raise InvalidInputError(
                f"simulator function {self.target!r}: {module.__file__} has no function "
                f"{attribute!r}{nearest(attribute, known)}."
            )
        return function  # type: ignore[no-any-return]

    def source_hash(self) -> str:
        """SHA-256 of the module's file and of those in the folder that it imports.

        Empty where it has none. It tells an edited simulator; but installed packages, and files
        that are read, are not in it.

        Raises
        ------
        InvalidInputError, SimulationError
            As `load`.
        """
        module = self._import(self.target.partition(":")[0])
        file = getattr(module, "__file__", None)  # a module built into Python has none
        if not file:
            return ""
        own = Path(file)
        files = [own] if self.folder is None else own_files(own, Path(self.folder))
        return hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()

    def __call__(self, x: npt.ArrayLike) -> FloatArray:
        """The outcomes of the situations `x` (n, d): (n,) of 1.0, 0.0 and NaN.

        With K consequences a table (n, 1 + K), the outcomes in its first column.

        Raises
        ------
        SimulationError
            If the function raises (its exception is chained), or returns something else.
        """
        rows = np.array(x, dtype=np.float64)  # the function may write on its own copy
        function = self.load()
        try:
            with _on_path(self.folder):
                outcomes = function(rows.copy())
        except (Exception, SystemExit) as error:  # a simulator that exits is no end of the run
            raise SimulationError(
                f"simulator function {self.target!r} raised {type(error).__name__} on an array of "
                f"shape {rows.shape}{_told(error, self.folder)}. It is given several situations at "
                "a time, one a row (x.T has the variables one by one); to mark one run as failed, "
                "return NaN for its row."
            ) from error
        what = f"simulator function {self.target!r}"
        return check_outcomes(outcomes, len(rows), what, self.consequences)

    def _import(self, name: str) -> ModuleType:
        try:
            with _on_path(self.folder):
                module = importlib.import_module(name)
        except ModuleNotFoundError as error:
            if error.name is None or not f"{name}.".startswith(f"{error.name}."):
                raise self._import_failed(name, error) from error  # a module it needs is missing
            raise InvalidInputError(
                f"simulator function {self.target!r}: no module {name!r} in "
                f"{self.folder or 'the current path'} nor among the installed packages."
            ) from None
        except (Exception, SystemExit) as error:
            raise self._import_failed(name, error) from error
        self._check_place(name, module)
        return module

    def _import_failed(self, name: str, error: BaseException) -> SimulationError:
        return SimulationError(
            f"simulator function {self.target!r}: importing {name!r} raised "
            f"{type(error).__name__}{_told(error, self.folder)}."
        )

    def _check_place(self, name: str, module: ModuleType) -> None:
        """Refuse a module of that name imported from elsewhere while the folder has its own."""
        if self.folder is None:
            return
        path = Path(self.folder, *name.split("."))
        own = [file for file in (path.with_suffix(".py"), path / "__init__.py") if file.exists()]
        if own and Path(module.__file__ or "").resolve() != own[0].resolve():
            raise InvalidInputError(
                f"simulator function {self.target!r}: expected the module {own[0]}, but the name "
                f"{name!r} is taken by {module.__file__ or 'a built-in module'}; rename the file."
            )


def _told(error: BaseException, folder: str | None) -> str:
    """What the exception says, and the line of the user's code that it comes from."""
    text = error.msg if isinstance(error, SyntaxError) else str(error)
    return f": {text}{_place(error, folder)}" if text else _place(error, folder)


def _place(error: BaseException, folder: str | None) -> str:
    """Where the user's code failed, such as `` (my_simulator.py, line 3)``; empty if nowhere."""
    if isinstance(error, SyntaxError):  # no line of that file was ever run
        return "" if error.filename is None else f" ({error.filename}, line {error.lineno})"
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if folder is not None and Path(f.filename).is_relative_to(folder)]
    foreign = [f for f in frames if f.filename != __file__ and "importlib" not in f.filename]
    last = (own or foreign)[-1:]
    return "".join(f" ({frame.filename}, line {frame.lineno})" for frame in last)


@contextmanager
def _on_path(folder: str | None) -> Iterator[None]:
    """Let `folder` be searched first for modules, as Python does for a script's own folder."""
    if folder is None:
        yield
        return
    importlib.invalidate_caches()  # the file may be younger than the last look at the folder
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)
