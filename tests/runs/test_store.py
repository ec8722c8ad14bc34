import re
import sqlite3

import numpy as np
import pytest

from crashrate.errors import StoreError
from crashrate.runs import store as store_module
from crashrate.runs.store import FILE, Batch, RunStore

ODD = np.array([[0.1, -0.0], [np.pi, 5e-324]])


@pytest.fixture
def store(tmp_path):
    with RunStore.create(tmp_path / "run", {"seed": "1"}) as store:
        yield store


def test_batches_come_back_bit_for_bit(store):
    store.append(0, Batch(ODD, np.array([1.0, np.nan])))
    store.append(1, Batch(-ODD, np.array([0.0, 1.0])))
    with RunStore.open(store.directory) as again:
        first, second = again.batches(2)
        assert again.config()["seed"] == "1"
    assert first.x.tobytes() == ODD.tobytes()
    assert second.x.tobytes() == (-ODD).tobytes()
    np.testing.assert_array_equal(first.outcomes, [1.0, np.nan])


def test_extended_batch_has_all_its_rows(store):
    store.append(0, Batch(ODD[:1], np.ones(1)))
    store.extend(0, Batch(ODD, np.array([1.0, 0.0])))
    (batch,) = store.batches(2)
    np.testing.assert_array_equal(batch.outcomes, [1.0, 0.0])


def test_same_batch_twice_is_another_process(store):
    store.append(0, Batch(ODD, np.zeros(2)))
    with pytest.raises(StoreError, match="another process"):
        store.append(0, Batch(ODD, np.ones(2)))
    np.testing.assert_array_equal(store.batches(2)[0].outcomes, [0.0, 0.0])


def test_no_store_is_created_over_another(store):
    with pytest.raises(StoreError, match="without a run"):
        RunStore.create(store.directory, {})


def test_file_killed_before_its_first_write_is_no_run(tmp_path):
    (tmp_path / FILE).touch()
    assert not RunStore.exists(tmp_path)
    RunStore.create(tmp_path, {}).close()
    assert RunStore.exists(tmp_path)


def test_other_schema_is_refused(store):
    with sqlite3.connect(store.directory / FILE) as raw:
        raw.execute("UPDATE config SET value = 'crashrate.run/99' WHERE key = 'schema'")
    raw.close()
    with pytest.raises(StoreError, match=r"expected the schema 'crashrate.run/1', got"):
        RunStore.open(store.directory)


@pytest.mark.parametrize("content", [b"not a database, but long enough to look at" * 20, b"x"])
def test_damaged_file_is_refused(tmp_path, content):
    (tmp_path / FILE).write_bytes(content)
    with pytest.raises(StoreError, match="expected a run written by crashrate"):
        RunStore.open(tmp_path)


def test_truncated_file_is_refused(store):
    for k in range(50):
        store.append(k, Batch(np.zeros((20, 2)), np.zeros(20)))
    store.close()
    path = store.directory / FILE
    path.write_bytes(path.read_bytes()[:8192])
    with pytest.raises(StoreError, match="restore"), RunStore.open(store.directory) as cut:
        cut.batches(2)


def test_missing_batch_and_short_blob_are_refused(store):
    for k in range(3):
        store.append(k, Batch(ODD, np.zeros(2)))
    with pytest.raises(StoreError, match="3 variables in batch 0"):
        store.batches(3)
    with sqlite3.connect(store.directory / FILE) as raw:
        raw.execute("DELETE FROM batches WHERE k = 1")
    raw.close()
    with pytest.raises(StoreError, match=r"expected batches 0 to 1, got batches \[0, 2\]"):
        store.batches(2)


def test_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StoreError, match="expected a folder to write to"):
        RunStore.create(tmp_path / "file" / "run", {})


def test_store_that_cannot_be_written_is_told_in_plain_words(store, monkeypatch):
    original = store_module._connect
    monkeypatch.setattr(store_module, "_connect", lambda directory, _: original(directory, "ro"))
    with RunStore.open(store.directory) as locked:
        with pytest.raises(StoreError, match="this run folder cannot be written"):
            locked.set_config("target", "other")
        assert locked.n_runs() == store.n_runs()


def test_what_is_in_the_place_of_a_run_folder_is_said(store):
    above = store.directory.parent
    for place, found in (
        (above / "nix", "found no such folder; start one"),
        (store.directory / "campaign.sqlite", "found a file; start one"),
        (above, f"but in {store.directory}; name one of them"),
    ):
        with pytest.raises(StoreError, match=re.escape(found)):
            RunStore.open(place)
