import pickle
import sys

import numpy as np
import pytest

from crashrate.errors import InvalidInputError, SimulationError
from crashrate.simulators import PythonFunction

SOURCE = """
import numpy as np

def crashes(x):
    x[:, 0] -= 1.0
    return x[:, 0] > 0

def failing(x):
    raise ZeroDivisionError("no road")

def margin(x):
    return x[:, 0]

def unfinished(x):
    return np.where(x[:, 0] > 0, np.nan, 0.0)

def with_helper(x):
    import helper_of_user_simulator
    return helper_of_user_simulator.crashes(x)

NUMBER = 3
"""


@pytest.fixture
def folder(tmp_path):
    before, path = set(sys.modules), list(sys.path)
    (tmp_path / "user_simulator.py").write_text(SOURCE)
    (tmp_path / "helper_of_user_simulator.py").write_text("def crashes(x): return x[:, 0] < 0\n")
    yield tmp_path
    assert sys.path == path
    for name in set(sys.modules) - before:
        if "user_simulator" in name:
            del sys.modules[name]


def test_function_of_the_scenarios_folder_is_called_on_a_copy(folder):
    simulate = PythonFunction("user_simulator:crashes", folder)
    x = np.array([[0.5], [2.0]])
    np.testing.assert_array_equal(simulate(x), [0.0, 1.0])
    np.testing.assert_array_equal(x, [[0.5], [2.0]])
    copy = pickle.loads(pickle.dumps(simulate))  # noqa: S301
    assert copy == simulate
    np.testing.assert_array_equal(copy(x), [0.0, 1.0])


def test_failed_rows_and_helpers_imported_late(folder):
    simulate = PythonFunction("user_simulator:unfinished", folder)
    np.testing.assert_array_equal(simulate([[1.0], [-1.0]]), [np.nan, 0.0])
    late = PythonFunction("user_simulator:with_helper", folder)
    np.testing.assert_array_equal(late([[1.0], [-1.0]]), [0.0, 1.0])


def test_package_function_needs_no_folder():
    assert PythonFunction("numpy.linalg:norm").load() is np.linalg.norm


def test_exception_of_the_function_is_chained_with_the_rows(folder):
    with pytest.raises(
        SimulationError, match=r"ZeroDivisionError on an array of shape \(5, .*no road"
    ) as caught:
        PythonFunction("user_simulator:failing", folder)(np.zeros((5, 2)))
    assert isinstance(caught.value.__cause__, ZeroDivisionError)


def test_failures_say_the_users_line(folder):
    with pytest.raises(SimulationError, match=r"no road \(.*user_simulator.py, line 9\)"):
        PythonFunction("user_simulator:failing", folder)(np.zeros((5, 2)))
    (folder / "late_user_simulator.py").write_text("\nimport no_such_dependency\n")
    with pytest.raises(SimulationError, match=r"late_user_simulator.py, line 2\)"):
        PythonFunction("late_user_simulator:crashes", folder).load()


def test_exit_of_the_users_code_is_a_simulation_error(folder):
    (folder / "leaving_user_simulator.py").write_text(
        "import sys\ndef crashes(x):\n    sys.exit(0)\n"
    )
    with pytest.raises(SimulationError, match=r"raised SystemExit .*line 3\)"):
        PythonFunction("leaving_user_simulator:crashes", folder)(np.zeros((5, 2)))
    (folder / "gone_user_simulator.py").write_text("raise SystemExit(0)\n")
    with pytest.raises(SimulationError, match="importing 'gone_user_simulator' raised SystemExit"):
        PythonFunction("gone_user_simulator:crashes", folder).load()


def test_edited_source_has_another_hash(folder):
    simulate = PythonFunction("user_simulator:crashes", folder)
    before = simulate.source_hash()
    assert len(before) == 64
    assert simulate.source_hash() == before
    (folder / "user_simulator.py").write_text(SOURCE + "# edited\n")
    assert simulate.source_hash() != before
    assert PythonFunction("sys:exit").source_hash() == ""


def test_edited_helper_beside_the_simulator_changes_the_hash(folder):
    (folder / "hashed_simulator.py").write_text(
        "import numpy\n\ndef crashes(x):\n    from hashed_helper import LIMIT\n"
        "    return x[:, 0] > LIMIT\n"
    )
    (folder / "hashed_helper.py").write_text("from hashed_deep import LIMIT\n")
    (folder / "hashed_deep.py").write_text("LIMIT = 1\n")
    (folder / "hashed_other.py").write_text("UNUSED = 1\n")
    simulate = PythonFunction("hashed_simulator:crashes", folder)
    before = simulate.source_hash()
    (folder / "hashed_other.py").write_text("UNUSED = 2\n")
    assert simulate.source_hash() == before
    assert simulate(np.array([[3.0], [0.0]])).tolist() == [1.0, 0.0]
    assert simulate.source_hash() == before  # whatever was imported since
    (folder / "hashed_deep.py").write_text("LIMIT = 2\n")
    assert simulate.source_hash() != before


def test_margin_is_refused_with_the_functions_name(folder):
    with pytest.raises(SimulationError, match=r"'user_simulator:margin'.*got 3.7 at row 0"):
        PythonFunction("user_simulator:margin", folder)([[3.7]])


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("user_simulator:crash", "has no function 'crash'; did you mean 'crashes'"),
        ("user_simulator:NUMBER", "has no function 'NUMBER'"),
        ("user_simulater:crashes", "no module 'user_simulater' in"),
        ("user_simulator.part:crashes", "no module|is not a package"),
        ("user_simulator", "expected 'module:function'"),
        ("user_simulator.py:crashes:now", "expected 'module:function'"),
        (":crashes", "expected 'module:function'"),
        ("../evil:crashes", "expected 'module:function'"),
    ],
)
def test_wrong_target_is_refused(folder, target, message):
    with pytest.raises(InvalidInputError, match=message):
        PythonFunction(target, folder).load()


def test_module_that_fails_is_a_simulation_error(folder):
    (folder / "broken_user_simulator.py").write_text("import no_such_dependency\n")
    with pytest.raises(SimulationError, match="No module named 'no_such_dependency'"):
        PythonFunction("broken_user_simulator:crashes", folder).load()
    (folder / "wrong_user_simulator.py").write_text("1 +\n")
    with pytest.raises(SimulationError, match="SyntaxError"):
        PythonFunction("wrong_user_simulator:crashes", folder).load()


def test_module_hidden_by_another_of_its_name_is_refused(folder):
    (folder / "json.py").write_text("def crashes(x): return x[:, 0] > 0\n")
    with pytest.raises(InvalidInputError, match="the name 'json' is taken by"):
        PythonFunction("json:crashes", folder).load()


def test_consequences_may_be_told_as_columns_or_by_name(folder):
    (folder / "more_of_user_simulator.py").write_text(
        "import numpy as np\n"
        "def columns(x):\n    return np.column_stack([x[:, 0] > 0, np.clip(x[:, 0], 0, 1)])\n"
        "def named(x):\n    return {'injury': np.clip(x[:, 0], 0, 1), 'crash': x[:, 0] > 0}\n"
    )
    for name in ("columns", "named"):
        simulate = PythonFunction(f"more_of_user_simulator:{name}", folder, ("injury",))
        np.testing.assert_array_equal(simulate([[0.5], [-1.0]]), [[1.0, 0.5], [0.0, 0.0]])
    with pytest.raises(SimulationError, match="columns the event, injury, got shape"):
        PythonFunction("user_simulator:crashes", folder, ("injury",))([[1.0]])
