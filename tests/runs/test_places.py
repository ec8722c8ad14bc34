import pytest

from crashrate import datasets
from crashrate.errors import InvalidInputError, StoreError
from crashrate.runs.places import (
    require_file_place,
    require_folder_place,
    require_run_place,
    traffic_named,
)
from crashrate.runs.store import RunStore


def test_places_that_can_be_made_are_fine(tmp_path):
    require_file_place(tmp_path / "new" / "folder" / "t.json")
    require_folder_place(tmp_path / "new" / "run")
    require_folder_place(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_what_is_in_the_way_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="found a folder; give a file's name"):
        require_file_place(tmp_path)
    for place in (tmp_path / "file", tmp_path / "file" / "deep" / "run"):
        with pytest.raises(StoreError, match="file is a file; choose another --out"):
            require_folder_place(place)


@pytest.mark.parametrize("name", ["result.json", "report.html"])
def test_a_run_writes_over_no_file_that_is_not_its_own(tmp_path, name):
    require_run_place(tmp_path)
    (tmp_path / name).write_text("mine")
    with pytest.raises(StoreError, match=f"holds a {name}, but no run that it is of"):
        require_run_place(tmp_path)
    (tmp_path / name).unlink()
    RunStore.create(tmp_path, {}).close()
    (tmp_path / name).write_text("of that run")
    require_run_place(tmp_path)


def test_no_permission_is_told(tmp_path, monkeypatch):
    (tmp_path / "t.json").write_text("")
    monkeypatch.setattr("crashrate.runs.places.os.access", lambda *_: False)  # root may all
    with pytest.raises(StoreError, match="this file cannot be written"):
        require_file_place(tmp_path / "t.json")
    with pytest.raises(StoreError, match="cannot be written to"):
        require_folder_place(tmp_path / "run")


def test_traffic_is_published_or_a_file(traffic, tmp_path):
    traffic.to_json(tmp_path / "t.json")
    assert traffic_named(str(tmp_path / "t.json")) == traffic
    assert traffic_named("published") == datasets.spmd_mixture()


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("nope.json", None, "no such file; give 'published', or a file"),
        ("events.parquet", "PAR1", "a table of events, no traffic model; fit one with"),
        ("t.json", "{", "something that is not JSON"),
        ("t.json", "[]", "expected a traffic model, written by 'crashrate fit'"),
        ("t.json", "", "something that is not JSON"),
    ],
)
def test_other_traffic_is_refused_by_name(tmp_path, name, text, says):
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    with pytest.raises(InvalidInputError, match=says) as raised:
        traffic_named(str(path))
    assert str(path) in str(raised.value)


def test_misspelt_published_is_told():
    with pytest.raises(
        InvalidInputError, match="--traffic publishd: no such file; give 'published'"
    ):
        traffic_named("publishd")


def test_damaged_numbers_name_the_file(traffic, tmp_path):
    path = tmp_path / "t.json"
    path.write_text(traffic.to_json().replace('"weights"', '"weight"'))
    with pytest.raises(InvalidInputError, match=r"t\.json"):
        traffic_named(str(path))
