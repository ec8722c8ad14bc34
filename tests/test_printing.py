"""What `fit` prints of a selection and of the fit that was kept."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from crashrate.estimation.alarms import Alarm
from crashrate.estimation.consequence import Consequence
from crashrate.estimation.strategy import Snapshot
from crashrate.printing import Format, print_fit, print_result, print_selection, standing
from crashrate.traffic.model import TrafficModel


@pytest.fixture
def selection():
    return {
        "n_components": [1, 2, 3], "bic": [90.0, 12.0, 15.0],
        "bic_restarts": [[90.0, 91.0], [12.0, 20.0], [15.0, None]], "admissible": [2, 3],
        "held_out": [[-3.0, -4.0], [-2.0, -2.9], [-2.001, -2.902]],
        "n_failed": [0, 0, 1], "left_out": [],
    }  # fmt: skip


def test_numbers_that_the_criterion_does_not_tell_apart_are_named(selection, capsys):
    print_selection(selection)
    shown = capsys.readouterr().out
    assert "not identified: BIC does not tell 2, 3 apart" in shown
    assert re.search(r"1 +90\.0 +1\.0 +-1050\.00 +99\.00\n", shown)
    assert re.search(r"2 +12\.0 +8\.0  lowest +0\.00 +1\.00  highest\n", shown)
    assert re.search(r"3 +15\.0 +0\.0 +-1\.50 +0\.00\n", shown)
    assert "per 1000" in shown
    assert len({len(line) for line in shown.splitlines()[1:3]}) == 2


def test_without_restarts_or_held_out_events_there_are_no_such_columns(selection, capsys):
    bare = selection | {"bic_restarts": [[90.0], [12.0], [15.0]], "held_out": []}
    print_selection(bare)
    shown = capsys.readouterr().out
    assert "spread" not in shown
    assert "eld out" not in shown


def test_held_out_scores_that_are_missing_show_as_such(selection, capsys):
    print_selection(selection | {"held_out": [[None, None]] * 3})
    shown = capsys.readouterr()
    assert shown.out.count("nan") == 6
    assert "highest\n" not in shown.out.split("Held out:")[0]
    assert shown.err == ""


def test_numbers_whose_every_start_failed_are_told(selection, capsys):
    print_selection(selection | {"left_out": [4, 5]})
    assert "Warning: no fit with 4, 5 components: every start" in capsys.readouterr().err


def model(**provenance):
    law = TrafficModel([1.0], [[0.0]], [[[1.0]]], [0.0], [np.inf], ["a"])
    alone = {"n_components": [1], "bic": [1.0], "left_out": []}
    return replace(law, provenance={"selection": alone, **provenance})


def test_the_kept_fit_shows_its_masses_its_prior_and_its_convergence(capsys):
    print_fit(model(prior_strength=1.0, promise=2.5e-8))
    shown = capsys.readouterr()
    assert shown.out == (
        "Kept fit: at least 50 % of every component lie in the box, prior worth 1 event, "
        "log likelihood within 2e-08 of its maximum per event.\n"
    )
    assert shown.err == ""


def test_a_prior_that_had_to_be_raised_is_warned_of(capsys):
    print_fit(model(prior_strength=100.0, promise=0.0))
    assert "Warning: the prior had to be raised from 1 to 100 events" in capsys.readouterr().err


def under_way(**changes):
    problem = SimpleNamespace(max_calls=2000, relative_half_width=0.1)
    plain = dict(snapshot=Snapshot(), n_calls=80, n_failed=0, goal="probability", problem=problem)
    return SimpleNamespace(**plain | changes)


def test_progress_follows_what_is_aimed_at():
    injury = Consequence(
        name="injury",
        mean=1e-7,
        interval=(0.8e-7, 1.2e-7),
        standard_error=1e-8,
        n_eff=100.0,
        n_carrying=30,
        largest_weight_share=0.1,
    )
    for aimed, says in ((False, "P = 1.00e-06 ± 50 %"), (True, "E(injury) = 1.00e-07 ± 20 %")):
        snapshot = Snapshot(
            probability=1e-6,
            interval=(5e-7, 1.5e-6),
            consequences=(replace(injury, aimed=aimed),),
            phase="estimate",
        )
        shown = standing(under_way(snapshot=snapshot))
        assert shown == f"80 of at most 2,000 runs, estimate: {says} (target ± 10 %)"


def test_progress_says_that_the_target_is_met_and_checked():
    for half, met in ((1.01e-7, ""), (0.99e-7, ", met: what it rests on is checked")):
        snapshot = Snapshot(probability=1e-6, interval=(1e-6 - half, 1e-6 + half), phase="estimate")
        assert standing(under_way(snapshot=snapshot)).endswith(f"(target ± 10 %{met})")


def test_progress_names_the_ends_of_an_interval_wider_than_its_estimate():
    snapshot = Snapshot(probability=1e-6, interval=(0.0, 0.031), phase="estimate")
    shown = standing(under_way(snapshot=snapshot))
    assert "P = 1.00e-06 in [0.0e+00, 3.1e-02] (target ± 10 %)" in shown


def test_progress_says_which_runs_were_stored():
    assert standing(under_way(), 120) == "going through 80 of 120 stored runs, explore"
    assert standing(under_way(), 70) == "80 of at most 2,000 runs, explore"


def test_progress_counts_what_failed():
    assert standing(under_way(n_failed=7)) == "80 of at most 2,000 runs, 7 failed, explore"


def test_progress_of_bounds():
    shown = standing(under_way(goal="bounds", snapshot=Snapshot(bounds=(1e-7, 3e-7))))
    assert shown == "80 of at most 2,000 runs, explore: 1.0e-07 ≤ P ≤ 3.0e-07 (target ± 10 %)"
    assert standing(under_way(goal="bounds")) == "80 of at most 2,000 runs, explore"


def shown_result(capsys, **changes):
    plain = {
        "sentence": "P(crash) = 2.0e-06 per encounter",
        "stop_reason": "the target was met",
        "alarms": [],
        "synthetic": False,
        "n_calls": 120,
        "method": "sequential",
        "traffic": {"n_members": 41, "events": {"n": 5000}},
        "recordings": {"sentences": ["replay: as it was"]},
    }
    print_result(plain | changes, Format.TEXT)
    return capsys.readouterr()


def test_a_result_that_was_checked_needs_no_note(capsys):
    shown = shown_result(capsys)
    assert shown.out == "P(crash) = 2.0e-06 per encounter\nreplay: as it was\n"
    assert shown.err == "Stopped: the target was met.\n"


@pytest.mark.parametrize(
    ("changes", "note"),
    [
        (
            {"recordings": {"unchecked": "it comes without events"}},
            "not checked against recordings: it comes without events.",
        ),
        ({"recordings": {"pending": "not replayed yet"}}, "Note: not replayed yet."),
        ({"traffic": {"n_members": 0, "events": {"n": 5000}}}, "Note: one fit to the events"),
        (
            {"vouched_sources": [{"n_runs": 1}, {"n_runs": 80}]},
            "the simulator was edited after 80 runs; the outcomes from before were kept",
        ),
    ],
)
def test_what_nobody_checked_is_noted(capsys, changes, note):
    assert note in shown_result(capsys, **changes).err


def test_of_a_method_that_leaves_members_out_it_is_not_said_that_there_are_none(capsys):
    traffic = {"n_members": 0, "events": {"n": 5000}}
    assert "one fit" not in shown_result(capsys, traffic=traffic, method="crude").err


def test_without_a_replay_the_order_stands_for_plain_traffic(capsys):
    unchecked = {"recordings": {"unchecked": "it comes without events"}}
    dropped = {"alarms": [{"name": Alarm.ORDER_DROPPED.name, "message": "dropped"}]}
    said = "the risk order was taken to hold in plain traffic"
    assert said in shown_result(capsys, **unchecked).err
    assert said not in shown_result(capsys).err
    assert said not in shown_result(capsys, **unchecked | dropped).err
    assert said not in shown_result(capsys, **unchecked, method="crude").err


def test_one_fit_to_drawn_events_or_to_none_needs_no_further_ones(capsys):
    for events, synthetic in (({"n": 5000}, True), ({}, False)):
        traffic = {"n_members": 0, "events": events}
        shown = shown_result(capsys, traffic=traffic, synthetic=synthetic)
        assert "one fit" not in shown.err


def test_what_was_aimed_at_comes_first(capsys):
    injury = {"sentence": "E(injury) = 1e-07", "aimed": True}
    fast = {"sentence": "E(fast) = 1e-08", "aimed": False}
    shown = shown_result(capsys, consequences=[fast, injury]).out.splitlines()
    assert [line[:9] for line in shown[:3]] == ["E(injury)", "P(crash) ", "E(fast) ="]


def test_draws_that_ended_ask_for_no_larger_budget(capsys):
    shown = shown_result(capsys, stop_reason="the budget of draws from the proposal ended").err
    assert "a larger --max-calls changes nothing" in shown
    assert "goes on from here" not in shown
