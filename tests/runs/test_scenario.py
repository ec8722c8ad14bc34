from pathlib import Path

import numpy as np
import pytest

from crashrate.crash_set.order import RiskOrder
from crashrate.errors import ScenarioError
from crashrate.runs import vehicle as vehicles
from crashrate.runs.scenario import Scenario
from crashrate.simulators import AccAeb, AccAebSimulator

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
MINIMAL = """
[variables.v_lead]
lower = 5
upper = 35
[variables.range]
lower = 0
[variables.closing_speed]
[simulator]
kind = "acc-aeb"
"""


def parse(text: str) -> Scenario:
    return Scenario.from_text(text, "cut")


def test_huang2017_says_what_the_study_did():
    scenario = Scenario.from_file(EXAMPLES / "huang2017.toml")
    assert scenario.name == "huang2017"
    assert scenario.names == ("v_lead", "inv_range", "inv_ttc")
    assert scenario.lower == (5.0, 0.013333333333333334, 0.0)
    assert scenario.upper == (35.0, np.inf, np.inf)
    assert [v.unit for v in scenario.variables] == ["m/s", "1/m", "1/s"]
    assert scenario.target.relative_half_width == 0.1
    assert scenario.target.max_calls == 2000
    assert scenario.target.confidence == 0.95
    assert scenario.events.closing == "inv_ttc"
    assert (scenario.outcome.event, scenario.outcome.per) == ("crash", "lane change")
    assert scenario.to_text() == (EXAMPLES / "huang2017.toml").read_text()


@pytest.mark.parametrize("name", ["huang2017", "cut_in"])
def test_examples_have_the_same_risk_and_plant_inputs(name):
    scenario = Scenario.from_file(EXAMPLES / f"{name}.toml")
    third = 20 * 0.05 if name == "huang2017" else 20.0
    x = np.array([[10.0, 0.05, third]])  # 10 m/s, 20 m, closing with 20 m/s
    order = RiskOrder.from_mapping(scenario.risk_mapping(), scenario.names)
    np.testing.assert_allclose(order(x), [[-10.0, 20.0, -20.0]])
    simulator = vehicles.simulator_of(scenario)
    assert isinstance(simulator, AccAebSimulator)
    inputs = {k: float(v[0]) for k, v in simulator.inputs(x).items()}
    assert inputs == pytest.approx({"v_lead": 10.0, "range": 20.0, "closing_speed": 20.0})
    expected = AccAeb.published() if name == "huang2017" else AccAeb()
    assert simulator.plant == expected


def test_cut_in_can_be_fitted_from_the_same_events():
    scenario = Scenario.from_file(EXAMPLES / "cut_in.toml")
    assert dict(scenario.events.columns) == {"closing_speed": "inv_ttc / inv_range"}
    assert scenario.events.closing == "closing_speed"


def test_no_risk_section_claims_nothing():
    scenario = parse(MINIMAL)
    assert scenario.risk is None
    assert scenario.risk_mapping() is None


def test_derived_may_use_earlier_derived():
    text = MINIMAL + '[derived]\nttc = "range / closing_speed"\ntwice = "2 * ttc"\n'
    twice = parse(text).derived["twice"]
    np.testing.assert_allclose(twice(np.array([[10.0, 30.0, 5.0]])), [12.0])


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("[simulator]", "[simulater]", "unknown section 'simulater'; did you mean 'simulator'"),
        ("lower = 0", "lowr = 0", "[variables.range]: unknown key 'lowr'; did you mean 'lower'"),
        ("lower = 0", 'lower = "0"', "lower: expected a number, got '0' (a text)"),
        ("lower = 0", "lower = true", "lower: expected a number, got True (true or false)"),
        ("lower = 0", "lower = nan", "lower: expected a number, got nan"),
        ("upper = 35", "upper = 5", "[variables.v_lead]: variable 'v_lead': expected lower < up"),
        ("upper = 35", "unit = 5", "unit: expected a text, got 5 (an integer)"),
        ("variables.range", 'variables."my range"', "expected a Python identifier"),
        ("acc-aeb", "acc-abe", "unknown kind 'acc-abe'; did you mean 'acc-aeb'"),
        ('kind = "acc-aeb"', "", "expected the vehicle under test, such as kind = 'python'"),
        ('"acc-aeb"', '"acc-aeb"\nfunction = "a:b"', "unknown key 'function'"),
        ('"acc-aeb"', '"acc-aeb"\npublished = 1', "published: expected true or false, got 1"),
        ('"acc-aeb"', '"acc-aeb"\npublished = true\nego_speed_cap = 3', "sets both caps"),
        ('"acc-aeb"', '"python"', 'expected function = "my_simulator:crashes", '),
        ('"acc-aeb"', '"acc-aeb"\n[risk]', "[risk]: expected name = direction; leave it out"),
        ('"acc-aeb"', '"acc-aeb"\n[risk]\nv_led = "decreasing"', "did you mean 'v_lead'"),
        ('"acc-aeb"', '"acc-aeb"\n[risk]\nrange = "down"', "[risk], range: expected 'increasing'"),
        ('"acc-aeb"', '"acc-aeb"\n[risk]\nrange = -1', "range: expected a text, got -1"),
        ('"acc-aeb"', '"acc-aeb"\n[derived]\nttc = "rnge / 2"', "'rnge'; did you mean 'range'"),
        ('"acc-aeb"', '"acc-aeb"\n[derived]\nttc = "range /"', "[derived], ttc:"),
        ('"acc-aeb"', '"acc-aeb"\n[derived]\nttc = "range.real"', "[derived], ttc:"),
        ('"acc-aeb"', '"acc-aeb"\n[derived]\nrange = "2 * range"', "the name is taken"),
        ('"acc-aeb"', '"acc-aeb"\n[derived]\nb = "2 * c"\nc = "range"', "unknown name 'c'"),
        ('"acc-aeb"', '"acc-aeb"\n[derived]\n"a b" = "range"', "Python identifier"),
        ('"acc-aeb"', '"acc-aeb"\n[target]\nmax_calls = 2e3', "max_calls: expected an integer"),
        ('"acc-aeb"', '"acc-aeb"\n[target]\ngoal = "bound"', "did you mean 'bounds'"),
        ('"acc-aeb"', '"acc-aeb"\n[target]\nmax_calls = 0', "max_calls: expected at least 1"),
        ('"acc-aeb"', '"acc-aeb"\n[target]\nmethod = "crud"', "'crud'; did you mean 'crude'"),
        ('"acc-aeb"', '"acc-aeb"\n[target]\nrelative_half_width = 10', "0.1 means ± 10 %"),
        ('"acc-aeb"', '"acc-aeb"\n[target]\nconfidence = 95', "expected a number between 0 and 1"),
        ('"acc-aeb"', '"acc-aeb"\n[target]\nrelative_half_width = 0', "up to 1 (0.1 means"),
        ('"acc-aeb"', '"acc-aeb"\n[events]\nclosing = "v_led"', "did you mean 'v_lead'"),
        ('"acc-aeb"', '"acc-aeb"\n[events.columns]\nrnge = "a"', "unknown variable 'rnge'"),
        ('"acc-aeb"', '"acc-aeb"\n[events.columns]\nrange = "a;"', "[events.columns], range:"),
        ('"acc-aeb"', '"acc-aeb"\n[events]\ncolumns = 3', "columns: expected a table, got 3"),
        ('"acc-aeb"', '"acc-aeb"\n[outcome]\nevents = "x"', "did you mean 'event'"),
        ("[simulator]", "[simulator", "cut.toml: expected TOML"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_refused_by_name(old, new, says):
    assert old in MINIMAL
    with pytest.raises(ScenarioError) as raised:
        parse(MINIMAL.replace(old, new))
    assert says in str(raised.value)
    assert "cut.toml" in str(raised.value)


def test_no_variables_and_no_file_are_refused(tmp_path):
    with pytest.raises(ScenarioError, match="expected at least one table"):
        parse('[simulator]\nkind = "acc-aeb"')
    with pytest.raises(ScenarioError, match=r"nothing\.toml: expected a scenario file"):
        Scenario.from_file(tmp_path / "nothing.toml")
    (tmp_path / "latin.toml").write_bytes(b"\xe9")
    with pytest.raises(ScenarioError, match=r"latin\.toml"):
        Scenario.from_file(tmp_path / "latin.toml")


def test_plant_that_lacks_an_input_says_which():
    text = MINIMAL.replace("variables.range", "variables.gap")
    with pytest.raises(ScenarioError, match="needs 'range'"):
        vehicles.simulator_of(parse(text))


def test_caps_reach_the_plant():
    text = MINIMAL + "closing_speed_cap = 20\nego_speed_cap = 30.5\n"
    assert vehicles.simulator_of(parse(text)).plant == AccAeb(20.0, 30.5)


def test_python_function_is_found_beside_the_scenario(scenario_file):
    simulate = vehicles.simulator_of(Scenario.from_file(scenario_file))
    np.testing.assert_array_equal(simulate(np.array([[0.2, 0.3], [1.0, 0.5]])), [0.0, 1.0])


def test_missing_python_function_is_refused_before_anything_runs(scenario_file):
    (scenario_file.parent / "other_vehicle.py").write_text("def crashes(x): return x[:, 0] > 1")
    text = scenario_file.read_text().replace("small_vehicle:crashes", "other_vehicle:crash")
    scenario_file.write_text(text)
    with pytest.raises(ScenarioError, match="did you mean 'crashes'"):
        vehicles.simulator_of(Scenario.from_file(scenario_file))


def test_fingerprint_knows_what_changes_a_run():
    text = (EXAMPLES / "huang2017.toml").read_text()
    same = parse(text.replace("# the columns", "# columns").replace("2000", "9"))
    other = parse(text.replace("published = true", "published = false"))
    assert parse(text).fingerprint == same.fingerprint
    assert parse(text).fingerprint != other.fingerprint


def test_order_of_variables_and_risk_matters():
    text = MINIMAL + '[risk]\nrange = "decreasing"\nv_lead = "decreasing"\n'
    swapped = MINIMAL + '[risk]\nv_lead = "decreasing"\nrange = "decreasing"\n'
    assert parse(text).fingerprint != parse(swapped).fingerprint
