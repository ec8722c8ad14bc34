"""Malformed tables of events: each is fitted or refused with one of our errors, nothing else.

python benchmarks/malformed.py > benchmarks/results/malformed.md

`--n 150` for fewer tables.
"""

import argparse
import math
import platform
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from crashrate.errors import CrashrateError
from crashrate.runs.fitting import fit_traffic, read_scenario_events
from crashrate.runs.scenario import Scenario

N = 10_000
MAX_ROWS = 60

Rows = np.ndarray
Damage = Callable[[Rows, np.random.Generator], Rows]


# --- what is wrong with the numbers


def fine(x: Rows, rng: np.random.Generator) -> Rows:
    del rng
    return x


def cells_of(value: float) -> Damage:
    def damage(x: Rows, rng: np.random.Generator) -> Rows:
        return np.where(rng.random(x.shape) < 0.1, value, x)

    return damage


def constant(x: Rows, rng: np.random.Generator) -> Rows:
    x[:, rng.integers(x.shape[1])] = rng.choice([0.0, 1.0, 1e-12, 3.7e9])
    return x


def all_equal(x: Rows, rng: np.random.Generator) -> Rows:
    del rng
    x[:] = x[:1]
    return x


def duplicate_column(x: Rows, rng: np.random.Generator) -> Rows:
    x[:, rng.integers(x.shape[1])] = x[:, 0]
    return x


def collinear(x: Rows, rng: np.random.Generator) -> Rows:
    x[:, -1] = x[:, 0] * 2.0 + 1e-9 * rng.normal(size=len(x))
    return x


def duplicate_rows(x: Rows, rng: np.random.Generator) -> Rows:
    return x[rng.integers(max(1, len(x) // 5), size=len(x))] if len(x) else x


def huge(x: Rows, rng: np.random.Generator) -> Rows:
    return x * 10.0 ** rng.choice([20, 100, 150, 200, 300, 307])


def tiny(x: Rows, rng: np.random.Generator) -> Rows:
    return x * 10.0 ** -float(rng.choice([20, 100, 150, 200, 300, 315]))


def mixed_sizes(x: Rows, rng: np.random.Generator) -> Rows:
    return x * 10.0 ** rng.integers(-12, 12, size=x.shape[1])


def far_away(x: Rows, rng: np.random.Generator) -> Rows:
    return x + 10.0 ** rng.integers(3, 16)


def one_outlier(x: Rows, rng: np.random.Generator) -> Rows:
    if len(x):
        x[0, 0] = 10.0 ** rng.integers(3, 200)
    return x


def integers(x: Rows, rng: np.random.Generator) -> Rows:
    del rng
    return np.round(x)


def heavy(x: Rows, rng: np.random.Generator) -> Rows:
    return np.abs(rng.standard_cauchy(x.shape))


def atom(x: Rows, rng: np.random.Generator) -> Rows:
    """A fifth of the rows exactly on the lower side, 0."""
    x = np.abs(x)
    x[rng.random(len(x)) < 0.2, rng.integers(x.shape[1])] = 0.0
    return x


def piled(x: Rows, rng: np.random.Generator) -> Rows:
    return rng.exponential(size=x.shape) ** 3


DAMAGES: dict[str, Damage] = {
    "nothing": fine,
    "empty cells": cells_of(math.nan),
    "infinite cells": cells_of(math.inf),
    "zeros": cells_of(0.0),
    "a constant column": constant,
    "all rows equal": all_equal,
    "a column twice": duplicate_column,
    "collinear columns": collinear,
    "repeated rows": duplicate_rows,
    "huge numbers": huge,
    "tiny numbers": tiny,
    "mixed magnitudes": mixed_sizes,
    "far from zero": far_away,
    "one outlier": one_outlier,
    "integers": integers,
    "Cauchy tails": heavy,
    "an atom on a side": atom,
    "piled up at a side": piled,
}


# --- what is wrong with the file


def csv_text(x: Rows) -> str:
    header = ",".join(f"x{k}" for k in range(x.shape[1]))
    return "\n".join([header, *(",".join(repr(float(v)) for v in row) for row in x)]) + "\n"


def as_csv(x: Rows, path: Path, rng: np.random.Generator) -> Path:
    del rng
    path = path.with_suffix(".csv")
    path.write_text(csv_text(x), encoding="utf-8")
    return path


def with_words(x: Rows, path: Path, rng: np.random.Generator) -> Path:
    words = ["n/a", "-", "1,5", "1e999", "0x10", '"', "NaN", "inf", "", "1_000", "١٢", "true"]
    lines = csv_text(x).splitlines()
    if len(lines) > 1:
        cells = lines[-1].split(",")
        cells[rng.integers(len(cells))] = str(rng.choice(words))
        lines[-1] = ",".join(cells)
    path = path.with_suffix(".csv")
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def ragged(x: Rows, path: Path, rng: np.random.Generator) -> Path:
    lines = csv_text(x).splitlines()
    k = int(rng.integers(len(lines)))
    lines[k] = lines[k] + ",7" if rng.random() < 0.5 else lines[k].rpartition(",")[0]
    path = path.with_suffix(".csv")
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def other_encoding(x: Rows, path: Path, rng: np.random.Generator) -> Path:
    path = path.with_suffix(".csv")
    encoding = str(rng.choice(["utf-16", "utf-32", "utf-8-sig", "cp037"]))
    path.write_bytes(csv_text(x).encode(encoding))
    return path


def noise(x: Rows, path: Path, rng: np.random.Generator) -> Path:
    """Bytes overwritten, or the file cut short, or empty, or all noise."""
    kind = int(rng.integers(4))
    writer = as_csv if rng.random() < 0.5 else as_parquet
    path = writer(x, path, rng)
    data = bytearray(path.read_bytes())
    if kind == 0 and data:
        for at in rng.integers(len(data), size=3):
            data[at] = int(rng.integers(256))
    elif kind == 1:
        data = data[: int(rng.integers(len(data) + 1))]
    else:
        data = bytearray(rng.bytes(200)) if kind == 2 else bytearray()
    path.write_bytes(bytes(data))
    return path


def as_parquet(x: Rows, path: Path, rng: np.random.Generator) -> Path:
    del rng
    return write_parquet({f"x{k}": pa.array(c) for k, c in enumerate(x.T)}, path)


def odd_types(x: Rows, path: Path, rng: np.random.Generator) -> Path:
    kinds = [pa.float32(), pa.string(), pa.bool_(), pa.int64(), pa.float16(), pa.null()]
    kinds += [pa.decimal128(38, 3), pa.timestamp("s"), pa.list_(pa.float64()), pa.uint8()]
    columns = {}
    for k, column in enumerate(x.T):
        kind = kinds[rng.integers(len(kinds))] if rng.random() < 0.5 else pa.float64()
        columns[f"x{k}"] = typed(column, kind)
    return write_parquet(columns, path)


def typed(column: np.ndarray, kind: pa.DataType) -> pa.Array:
    """A column of a type, where it can be had; else of text, of nothing or of lists."""
    if pa.types.is_list(kind):
        return pa.array([[v] for v in column], type=kind)
    if pa.types.is_null(kind):
        return pa.nulls(len(column))
    try:
        return pa.array(column).cast(kind, safe=False)
    except pa.ArrowException:
        return pa.array([str(v) for v in column])


def write_parquet(columns: dict[str, pa.Array], path: Path) -> Path:
    path = path.with_suffix(".parquet")
    parquet.write_table(pa.table(columns), path)
    return path


FILES = {
    "CSV": as_csv,
    "Parquet": as_parquet,
    "words among numbers": with_words,
    "ragged rows": ragged,
    "other encodings": other_encoding,
    "damaged bytes": noise,
    "odd Parquet types": odd_types,
}
USUAL = 0.55  # of the tables are well-formed files


def scenario(d: int, rng: np.random.Generator) -> Scenario:
    """Variables with or without sides, some that exclude, some on a log scale."""
    text = ""
    for k in range(d):
        text += f"[variables.x{k}]\n"
        kind = int(rng.integers(5))
        text += ["", "lower = 0\n", "lower = -1\nupper = 1\n", "lower = 50\n", ""][kind]
        text += 'lower = 0\nscale = "log"\n' if kind == 4 else ""
    return Scenario.from_text(text + '[simulator]\nkind = "python"\nfunction = "a:b"\n')


def outcome(scene: Scenario, path: Path, k: int, *, drop: bool) -> str:
    """fitted, the name of one of our errors, or what else came."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            events = read_scenario_events(scene, path, drop_invalid=drop)
            model = fit_traffic(scene, events, (k,))
        finite = np.isfinite(model.log_density(events.values)).all()
    except CrashrateError as error:
        return type(error).__name__
    except Exception as error:  # noqa: BLE001 - what is looked for
        return f"UNEXPECTED {type(error).__name__}: {error}"
    return "fitted" if finite else "UNEXPECTED density"


def one_table(i: int, folder: Path) -> tuple[str, str, str]:
    """What was wrong with table i and its file, and what came of it."""
    rng = np.random.default_rng([2026, i])
    n, d = int(rng.integers(MAX_ROWS)), int(rng.integers(1, 4))
    wrong = str(rng.choice(list(DAMAGES)))
    usual = rng.random() < USUAL
    kind = str(rng.choice(["CSV", "Parquet"] if usual else list(FILES)))
    scene = scenario(d, rng)
    with np.errstate(all="ignore"):
        x = DAMAGES[wrong](rng.normal(size=(n, d)) + rng.choice([0.0, 3.0]), rng)
        path = FILES[kind](x, folder / "table", rng)
    k, drop = int(rng.integers(1, 4)), bool(rng.random() < 0.7)
    return wrong, kind, outcome(scene, path, k, drop=drop)


def study(n: int, folder: Path) -> list[tuple[str, str, str]]:
    return [one_table(i, folder) for i in range(n)]


def table(title: str, found: list[tuple[str, str]]) -> None:
    counts = Counter(found)
    ends = sorted({end for _, end in found}, key=lambda end: (end != "fitted", end))
    print(f"\n| {title} | {' | '.join(ends)} |")
    print(f"|---|{'---|' * len(ends)}")
    for name in dict.fromkeys(name for name, _ in sorted(found)):
        print(f"| {name} | {' | '.join(str(counts[name, end]) for end in ends)} |")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--n", type=int, default=N)
    n = parser.parse_args().n
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        found = study(n, Path(folder))
    unexpected = [(i, *f) for i, f in enumerate(found) if f[2].startswith("UNEXPECTED")]
    print("# Malformed tables of events\n")
    command = "python benchmarks/malformed.py" + (f" --n {n}" if n != N else "")
    print(
        f"`{command}`; Python {platform.python_version()}, {time.perf_counter() - start:.0f} s.\n"
    )
    print(f"{n:,} random tables of up to {MAX_ROWS} rows, read and fitted. Neither fitted nor")
    print(f"refused with an error of crashrate's: **{len(unexpected)}**.")
    table("numbers", [(wrong, end.partition(":")[0]) for wrong, _, end in found])
    table("file", [(kind, end.partition(":")[0]) for _, kind, end in found])
    for line in unexpected[:20]:
        print("\n" + " / ".join(str(part) for part in line))


if __name__ == "__main__":
    main()
