"""The copy of the events beside a traffic model."""

from dataclasses import replace

import numpy as np
import pytest

from crashrate.errors import InvalidInputError, StoreError
from crashrate.events import EventTable
from crashrate.runs import recorded


@pytest.fixture
def events(traffic):
    rows = np.array([3, 5, 8, 13])
    return EventTable(("a", "b"), traffic.sample(4, 0), "drawn.csv", rows, {"not closing": 2})


@pytest.fixture
def model(traffic, events):
    return replace(traffic, provenance={"events": {"sha256": recorded.digest(events)}})


def test_what_is_written_is_read_to_the_bit(tmp_path, events, model):
    file = tmp_path / "traffic.json"
    assert recorded.write_events(file, events) == tmp_path / "traffic.events.parquet"
    got = recorded.read_events_beside(file, model)
    assert got.values.tobytes() == events.values.tobytes()
    assert got.rows.tolist() == [3, 5, 8, 13]
    assert (got.source, got.dropped, got.names) == ("drawn.csv", {"not closing": 2}, ("a", "b"))


def test_no_file_and_no_memory_of_events_are_no_error(tmp_path, events, model, traffic):
    assert recorded.read_events_beside(tmp_path / "traffic.json", model) is None
    recorded.write_events(tmp_path / "traffic.json", events)
    assert recorded.read_events_beside(tmp_path / "traffic.json", traffic) is None
    assert recorded.events_for("published", traffic, "sequential") == (
        None,
        "it comes without events",
    )


def test_why_there_are_no_events_is_said(tmp_path, events, model):
    file = str(tmp_path / "traffic.json")
    found, note = recorded.events_for(file, model, "sequential")
    assert found is None
    assert "traffic.events.parquet, which 'crashrate fit' writes" in note
    recorded.write_events(tmp_path / "traffic.json", events)
    found, note = recorded.events_for(file, model, "sequential")
    assert (len(found), note) == (4, "")
    found, note = recorded.events_for(file, model, "huang2017")
    assert found is None
    assert "learns no crash set" in note


def test_other_events_are_refused(tmp_path, events, model):
    other = replace(events, values=events.values + 1.0)
    recorded.write_events(tmp_path / "traffic.json", other)
    with pytest.raises(InvalidInputError, match="expected the events that traffic"):
        recorded.read_events_beside(tmp_path / "traffic.json", model)


def test_a_damaged_file_is_refused(tmp_path, model):
    (tmp_path / "traffic.events.parquet").write_text("no table")
    with pytest.raises(InvalidInputError, match="expected the copy of the events"):
        recorded.read_events_beside(tmp_path / "traffic.json", model)


def test_a_file_of_the_user_is_never_replaced(tmp_path):
    file = tmp_path / "traffic.json"
    (tmp_path / "traffic.events.parquet").write_text("mine")
    with pytest.raises(StoreError, match="a file of yours"):
        recorded.require_replaceable_events(file, tmp_path / "events.csv")


def test_a_copy_is_replaced_but_not_while_it_is_read(tmp_path, events):
    file = tmp_path / "traffic.json"
    copy = recorded.write_events(file, events)
    recorded.require_replaceable_events(file, tmp_path / "events.csv")
    with pytest.raises(StoreError, match="a file of yours"):
        recorded.require_replaceable_events(file, copy)
