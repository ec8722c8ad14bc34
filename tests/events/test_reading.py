from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from crashrate.errors import EventsError
from crashrate.events import EventTable, read_events
from crashrate.variables import Variable

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared" / "data"
VARIABLES = (
    Variable("v_lead", "m/s", 5.0, 35.0),
    Variable("inv_range", "1/m", 1.0 / 75.0),
    Variable("inv_ttc", "1/s", 0.0),
)
RANGE, RANGE_RATE = "range not a finite number", "range_rate not a finite number"
FROM_RANGE = {"inv_range": "1 / range", "inv_ttc": "-range_rate / range"}  # eq. (1)

CSV = """v_lead,range,range_rate,driver
10.0,50.0,-5.0,ann
20.5,25,2.0,bob
30,20.0,-1e0,cid
"""


def write(folder, text=CSV, name="events.csv"):
    path = folder / name
    path.write_text(text)
    return path


def test_variables_are_computed_from_the_columns_of_the_file(tmp_path):
    path = write(tmp_path)
    table = read_events(path, VARIABLES, FROM_RANGE, closing="inv_ttc")
    assert isinstance(table, EventTable)
    assert table.names == ("v_lead", "inv_range", "inv_ttc")
    np.testing.assert_allclose(table.values, [[10.0, 0.02, 0.1], [30.0, 0.05, 0.05]], rtol=1e-15)
    np.testing.assert_array_equal(table.rows, [0, 2])
    assert table.dropped == {"not closing": 1}
    assert (len(table), table.n_read, table.source) == (2, 3, str(path))
    assert table.summary() == f"{path}: 2 events of 3 rows; dropped: 1 not closing"
    assert not table.values.flags.writeable


def test_variables_may_be_columns_themselves_in_any_order(tmp_path):
    path = write(tmp_path, "inv_ttc,v_lead,other,inv_range\n0.1,10,x,0.5\n0.2,11,,0.25\n")
    table = read_events(path, VARIABLES, closing="inv_ttc")
    np.testing.assert_array_equal(table.values, [[10.0, 0.5, 0.1], [11.0, 0.25, 0.2]])
    assert table.summary().endswith("2 events, no row dropped")


def test_without_a_closing_variable_no_row_is_dropped(tmp_path):
    variables = (*VARIABLES[:2], Variable("inv_ttc"))
    table = read_events(write(tmp_path), variables, FROM_RANGE)
    assert len(table) == 3
    assert table.dropped == {}


def test_an_event_that_opens_may_lie_outside_the_bounds(tmp_path):
    path = write(tmp_path, CSV + "99,10,3,dee\n")
    table = read_events(path, VARIABLES, FROM_RANGE, closing="inv_ttc")
    assert table.dropped == {"not closing": 2}


@pytest.mark.parametrize(
    ("row", "message", "reason"),
    [
        ("36.5,50,-5", "'v_lead': expected 5.0 to 35.0 m/s, got 36.5", "v_lead out of bounds"),
        ("4,50,-5", "got 4.0", "v_lead out of bounds"),
        ("10,80,-5", r"variable 'inv_range': .* got 0.0125", "inv_range out of bounds"),
        ("10,,-5", "column 'range': expected a finite number, got an empty cell", RANGE),
        ("10,50,nan", "column 'range_rate': expected a finite number, got 'nan'", RANGE_RATE),
        ("10,50,-inf", "got '-inf'", RANGE_RATE),
        ("10,far,-5", "column 'range': expected a finite number, got 'far'", RANGE),
        ('10,"1,5",-5', "got '1,5'", RANGE),
        ("10,1_0,-5", "got '1_0'", RANGE),
        ("10,0,-5", r"inv_range = 1 / range is inf at range = '0'", "inv_range undefined"),
        ("10,0,0", "inv_range = 1 / range is inf", "inv_range undefined"),
    ],
)
def test_bad_row_is_named_or_dropped_and_counted(tmp_path, row, message, reason):
    path = write(tmp_path, CSV + row + ",eve\n" + row + ",eve\n40,10,1,fay\n")
    with pytest.raises(EventsError, match=message) as caught:
        read_events(path, VARIABLES, FROM_RANGE, closing="inv_ttc")
    assert f"{path}, data row 4" in str(caught.value)
    assert "2 such rows of 6" in str(caught.value)
    assert "--drop-invalid" in str(caught.value)
    table = read_events(path, VARIABLES, FROM_RANGE, closing="inv_ttc", drop_invalid=True)
    assert table.dropped == {"not closing": 2, f"with {reason}": 2}
    np.testing.assert_array_equal(table.rows, [0, 2])


def test_a_row_with_two_faults_counts_once(tmp_path):
    path = write(tmp_path, CSV + "99,nan,-5,eve\n")
    table = read_events(path, VARIABLES, FROM_RANGE, closing="inv_ttc", drop_invalid=True)
    assert sum(table.dropped.values()) + len(table) == table.n_read == 4


def test_a_table_without_names_is_told_so(tmp_path):
    with pytest.raises(EventsError, match="add a row of names above it"):
        read_events(write(tmp_path, "10,0.2,0.1\n12,0.3,0.2\n"), VARIABLES, {})
    with pytest.raises(EventsError) as refused:
        read_events(write(tmp_path), VARIABLES, {})
    assert "row of names" not in str(refused.value)


def test_text_deep_in_a_column_of_numbers_is_found(tmp_path):
    n = 100_000  # beyond the block from which a type would be guessed
    lines = [f"10,50,-{k % 50 + 1}" for k in range(n)]
    lines[n - 7] = "10,5O,-1"
    path = write(tmp_path, "v_lead,range,range_rate\n" + "\n".join(lines) + "\n")
    with pytest.raises(EventsError, match=f"data row {n - 6}: column 'range': .*got '5O'"):
        read_events(path, VARIABLES, FROM_RANGE)


@pytest.mark.parametrize(
    ("columns", "closing", "message"),
    [
        ({}, None, "no column 'inv_range'; did you mean 'range'.*events.columns"),
        ({"inv_range": "1 / rang"}, None, "variable 'inv_range': .*did you mean 'range'"),
        (FROM_RANGE | {"inv_rang": "1"}, None, "'inv_rang' is not a variable; did you mean"),
        (FROM_RANGE | {"v_lead": "30"}, None, "got the constant '30'"),
        (FROM_RANGE | {"v_lead": "open('x')"}, None, "unknown function 'open'"),
        (FROM_RANGE | {"v_lead": "driver"}, None, "column 'driver': .*got 'ann'"),
        (FROM_RANGE, "inv_tc", "'inv_tc' is not a variable; did you mean 'inv_ttc'"),
    ],
)
def test_wrong_columns_are_named_with_the_nearest(tmp_path, columns, closing, message):
    with pytest.raises(EventsError, match=message):
        read_events(write(tmp_path), VARIABLES, columns, closing=closing)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "header line: Empty CSV file"),
        ("v_lead,range,range_rate\n", "at least 2 events, got 0 rows"),
        ("v_lead,range,range_rate\n10,50,-5\n", "at least 2 events, got 1 row\\."),
        ("v_lead,range,range_rate\n10,50,5\n10,50,-5\n", r"got 1 of 2 rows \(1 not closing\)"),
        ("v_lead,range,range_rate,range\n1,2,3,4\n", "'range' 2 times"),
        ("v_lead,range,range_rate\n1,2,3\n1,2\n", "Expected 3 columns, got 2"),
        ("v_lead;range;range_rate\n1;2;3\n", "separated by semicolons"),
    ],
)
def test_malformed_tables_are_refused(tmp_path, text, message):
    with pytest.raises(EventsError, match=message):
        read_events(write(tmp_path, text), VARIABLES, FROM_RANGE, closing="inv_ttc")


def test_files_that_are_not_tables_are_refused(tmp_path):
    with pytest.raises(EventsError, match="no such file"):
        read_events(tmp_path / "missing.csv", VARIABLES)
    with pytest.raises(EventsError, match=r"ends in \.csv, \.parquet, \.mat, got '\.xlsx'"):
        read_events(tmp_path / "events.xlsx", VARIABLES)
    with pytest.raises(EventsError, match="got 'no ending'"):
        read_events(tmp_path / "events", VARIABLES)
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(EventsError, match="no such file"):
        read_events(tmp_path / "folder.csv", VARIABLES)
    with pytest.raises(EventsError, match="at least one variable"):
        read_events(write(tmp_path), ())
    (tmp_path / "latin.csv").write_bytes(b"v_lead,Stra\xdfe\n1,2\n")
    with pytest.raises(EventsError, match="UTF-8"):
        read_events(tmp_path / "latin.csv", VARIABLES[:1])


def test_single_precision_is_widened_and_meets_its_bounds(tmp_path):
    path = tmp_path / "events.parquet"
    bound = Variable("share", "", 0.0, 0.1)
    assert float(np.float32(0.1)) > 0.1
    pq.write_table(pa.table({"share": pa.array([0.05, 0.1], pa.float32())}), path)
    table = read_events(path, [bound])
    assert table.values.dtype == np.float64
    np.testing.assert_array_equal(table.values[:, 0], [float(np.float32(0.05)), 0.1])
    assert table.n_on_bound == 1
    # negative control: one step of single precision further is outside, and so is the same value
    # where the file holds double precision
    beyond = np.nextafter(np.float32(0.1), np.float32(1.0))
    pq.write_table(pa.table({"share": pa.array([0.05, beyond], pa.float32())}), path)
    with pytest.raises(EventsError, match="data row 2: variable 'share'"):
        read_events(path, [bound])
    pq.write_table(pa.table({"share": [0.05, float(np.float32(0.1))]}), path)
    with pytest.raises(EventsError, match="data row 2: variable 'share'"):
        read_events(path, [bound])


@pytest.mark.skipif(
    not (SHARED / "spmd_lane_changes.parquet").exists(),
    reason="needs ../shared/data/spmd_lane_changes.parquet",
)
def test_every_recorded_lane_change_is_read():
    table = read_events(SHARED / "spmd_lane_changes.parquet", VARIABLES, closing="inv_ttc")
    assert len(table) == table.n_read == 157_757
    cut_in = (*VARIABLES[:2], Variable("closing_speed", "m/s", 0.0))
    columns = {"closing_speed": "inv_ttc / inv_range"}
    other = read_events(
        SHARED / "spmd_lane_changes.parquet", cut_in, columns, closing="closing_speed"
    )
    np.testing.assert_allclose(
        other.values[:, 2], table.values[:, 2] / table.values[:, 1], rtol=1e-15
    )


@pytest.mark.skipif(
    not (SHARED / "tno_cut_ins.csv").exists(), reason="needs ../shared/data/tno_cut_ins.csv"
)
def test_real_cut_ins_in_other_columns_are_read():
    columns = {"inv_range": "1 / range_m", "inv_ttc": "-range_rate / range_m"}
    table = read_events(
        SHARED / "tno_cut_ins.csv", VARIABLES, columns, closing="inv_ttc", drop_invalid=True
    )
    assert table.n_read == 891
    assert 150 < len(table) < 300
    assert table.dropped["not closing"] > 600
    assert (table.values[:, 2] > 0.0).all()
