import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from crashrate.errors import EventsError
from crashrate.events import EventTable, read_events
from crashrate.events.sources import open_source
from crashrate.variables import Variable

AB = (Variable("a"), Variable("b", "", 0.0, 10.0))
EXPECTED = [[1.0, 2.0], [3.0, 4.0], [-5.0, 0.5]]


def test_csv_with_blanks_quotes_and_a_byte_order_mark(tmp_path):
    path = tmp_path / "events.CSV"
    path.write_bytes(b'\xef\xbb\xbfa, note, b\r\n 1,"x, y", 2\r\n\r\n+3.,,4\r\n"-5",z,.5\r\n')
    np.testing.assert_array_equal(read_events(path, AB).values, EXPECTED)


@pytest.mark.parametrize("kind", [pa.float64(), pa.float32(), pa.float16()])
def test_parquet_of_any_precision(tmp_path, kind):
    path = tmp_path / "events.parquet"
    table = {"a": pa.array([1, 3, -5], pa.int16()), "b": pa.array(np.float16([2, 4, 0.5]))}
    table["b"] = table["b"].cast(kind)
    pq.write_table(pa.table(table), path)
    np.testing.assert_array_equal(read_events(path, AB).values, EXPECTED)


def test_parquet_says_which_cell_is_empty_and_which_column_is_no_number(tmp_path):
    path = tmp_path / "events.parquet"
    pq.write_table(pa.table({"a": [1, None, 3], "b": [1.0, 2.0, float("nan")]}), path)
    with pytest.raises(EventsError, match=r"data row 2: column 'a': .* got an empty cell"):
        read_events(path, AB)
    with pytest.raises(EventsError, match=r"data row 3: column 'b': .* got nan"):
        read_events(path, AB[1:])
    for cells in (["1", "2"], [True, False], [[1], [2]]):
        pq.write_table(pa.table({"a": cells}), path)
        with pytest.raises(EventsError, match="column 'a': expected numbers, got type"):
            read_events(path, AB[:1])


def test_mat_with_vectors_a_structure_or_a_matrix(tmp_path):
    path = tmp_path / "events.mat"
    a, b = np.array(EXPECTED).T
    savemat(path, {"a": a, "b": b[:, None], "text": "hello", "cell": np.array([{}], dtype=object)})
    np.testing.assert_array_equal(read_events(path, AB).values, EXPECTED)
    savemat(path, {"data": {"a": a, "b": b.astype(np.float32)}, "long": np.arange(100)})
    np.testing.assert_array_equal(read_events(path, AB).values, EXPECTED)
    savemat(path, {"data": np.array(EXPECTED)}, do_compression=True)
    table = read_events(path, AB, {"a": "data_1", "b": "data_2"})
    np.testing.assert_array_equal(table.values, EXPECTED)


def test_mat_that_is_not_columns_of_numbers_is_refused(tmp_path):
    path = tmp_path / "events.mat"
    savemat(path, {"a": [1.0, 2.0, 3.0], "b": [1.0, 2.0]})
    with pytest.raises(EventsError, match="one length, got a 3, b 2"):
        read_events(path, AB)
    savemat(path, {"a": [1j, 2.0], "b": [1.0, 2.0]})
    with pytest.raises(EventsError, match="column 'a': expected real numbers, got type complex"):
        read_events(path, AB)
    savemat(path, {"first": {"a": [1.0, 2.0]}, "a": [1.0, 2.0]})
    with pytest.raises(EventsError, match="'a' 2 times"):
        read_events(path, AB[:1])
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(400))
    with pytest.raises(EventsError, match=r"version 7.3; save it in MATLAB"):
        read_events(path, AB)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a;b\n1,5;2\n", "semicolons"),
        ("a;b\n1;2\n", "semicolons"),
        ("a\tb\n1\t2\n", "tabs"),
    ],
)
def test_csv_of_other_separators_is_refused_with_a_hint(tmp_path, text, words):
    path = tmp_path / "events.csv"
    path.write_text(text)
    with pytest.raises(EventsError, match=f"separated by {words}: save it again with commas"):
        _ = open_source(path).names


@pytest.mark.parametrize("ending", [".csv", ".parquet", ".mat"])
@pytest.mark.parametrize("content", [b"", b"\n", b"\0", bytes(300), b"PAR1garbagePAR1"])
def test_garbage_is_refused_by_every_reader(tmp_path, ending, content):
    path = tmp_path / f"events{ending}"
    path.write_bytes(content)
    with pytest.raises(EventsError):
        read_events(path, AB)


CELLS = st.one_of(
    st.integers(-20, 20).map(str),
    st.floats(width=32).map(str),
    st.sampled_from(["", " ", "NA", "nan", "1e400", "1,5", '"', "x", "é", "-", "0x1", "\0", "#"]),
)


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    header=st.lists(
        st.sampled_from(["a", "b", "c", "", "a b", '"a"', "é"]), min_size=1, max_size=4
    ),
    rows=st.lists(st.lists(CELLS, min_size=1, max_size=4), max_size=6),
    columns=st.sampled_from([{}, {"a": "b"}, {"a": "c / b", "b": "a * a"}, {"b": "log(a) +"}]),
    closing=st.sampled_from([None, "a"]),
    drop_invalid=st.booleans(),
)
def test_any_table_is_read_or_refused_as_events(  # noqa: PLR0917
    tmp_path, header, rows, columns, closing, drop_invalid
):
    path = tmp_path / "events.csv"
    path.write_text("\n".join(",".join(row) for row in [header, *rows]), encoding="utf-8")
    try:
        table = read_events(path, AB, columns, closing=closing, drop_invalid=drop_invalid)
    except EventsError as error:
        assert str(path) in str(error)  # noqa: PT017 - either outcome is allowed
        return
    assert isinstance(table, EventTable)
    assert np.isfinite(table.values).all()
    assert ((table.values[:, 1] >= 0.0) & (table.values[:, 1] <= 10.0)).all()
    assert table.n_read == len(table) + sum(table.dropped.values())
    assert drop_invalid or set(table.dropped) <= {"not closing"}


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.data())
def test_a_damaged_file_is_read_or_refused_as_events(tmp_path, data):
    ending = data.draw(st.sampled_from([".csv", ".parquet", ".mat"]))
    path = tmp_path / f"events{ending}"
    a, b = np.array(EXPECTED).T
    if ending == ".csv":
        path.write_text("a,b\n1,2\n3,4\n-5,.5\n")
    elif ending == ".parquet":
        pq.write_table(pa.table({"a": a, "b": b}), path)
    else:
        savemat(path, {"a": a, "b": b})
    content = bytearray(path.read_bytes())
    # scipy's reader of .mat is not made for overwritten bytes (it may end the process): cut only
    for _ in range(0 if ending == ".mat" else data.draw(st.integers(0, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    try:
        table = read_events(path, AB, drop_invalid=True)
    except EventsError:
        return
    assert np.isfinite(table.values).all()


def test_readers_libraries_load_only_when_a_file_is_opened():
    code = (
        "import sys, crashrate.events;"
        "print([m for m in ('pyarrow', 'scipy.io', 'pandas') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_names_are_those_of_the_file_in_its_order(tmp_path):
    path = tmp_path / "events.csv"
    path.write_text("b,a\n1,2\n")
    assert open_source(path).names == ("b", "a")
