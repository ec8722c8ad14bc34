"""What the recordings say about the answer, as the tables of the report."""

from dataclasses import dataclass, replace

from crashrate.recordings.check import Check
from crashrate.recordings.influential import Influential
from crashrate.recordings.ladder import Ladder
from crashrate.recordings.near_misses import Tail
from crashrate.recordings.replay import Replay
from crashrate.recordings.rivals import Rival
from crashrate.reports.axes import units_of, variable_axes
from crashrate.reports.numbers import count, interval_text, percent, plain, power_of_ten
from crashrate.runs.looked_at import why_not_looked_at
from crashrate.runs.record import RunRecord


@dataclass(frozen=True)
class Sheet:
    """One table: a title, what it says, headings and cells as they are shown.

    Parameters
    ----------
    key, title, text : str
    headings : tuple of str
    rows : tuple of tuple of str
        The first cell heads its row.
    """

    key: str
    title: str
    text: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def check_of(record: RunRecord) -> Check | None:
    """What the run's recordings said; None where none were at hand."""
    values = record.result.get("recordings")
    if not values or why_not_looked_at(record.result):
        return None
    found, units = Check.from_dict(values), units_of(record.scenario)
    named = (replace(t, unit=t.unit or units.get(t.name, "")) for t in found.tails)
    return replace(found, tails=tuple(named))


def sheets(record: RunRecord) -> tuple[Sheet, ...]:
    """The tables, those that there are."""
    found = check_of(record)
    if found is None:
        return ()
    parts = [_ways(record, found)]
    if found.ladder is not None:
        parts.append(_ladder(found.ladder))
    if found.tails:
        parts.append(_tails(found.tails, found.rivals))
    if found.influential is not None:
        parts.append(_influence(record, found, found.influential))
    return tuple(parts)


def _ways(record: RunRecord, c: Check) -> Sheet:
    """Every way to the number, side by side."""
    result, bic = record.result, record.traffic.provenance.get("bic")
    low, high = result["interval"]
    rows = [
        ("This run", power_of_ten(result["probability"]), interval_text((low, high)),
         count(bic), _deviance(c.ladder)),
        ("Replay of the events", power_of_ten(c.replay.probability),
         interval_text(c.replay.interval), "–", "–"),
    ]  # fmt: skip
    if c.extremes is not None:
        e = c.extremes
        rows.append(
            ("Extreme-value theory", power_of_ten(e.probability), interval_text(e.interval),
             "–", "–")
        )  # fmt: skip
    rows += [
        (_named(r), power_of_ten(r.probability), "–", count(r.bic),
         _deviance(r.ladder))
        for r in c.rivals
    ]  # fmt: skip
    return Sheet(
        "ways",
        "Other ways to the same number",
        _ways_text(c),
        ("", "Probability", f"{100 * c.replay.confidence:g} % interval", "BIC", "Ladder"),
        tuple(rows),
    )


def _named(r: Rival) -> str:
    return r.name[0].upper() + r.name[1:]


def _ways_text(c: Check) -> str:
    r = c.replay
    text = (
        f"Replay counts the {r.n_events:,} events themselves: {r.n_simulated} simulator runs, "
        f"{_in_doubt(r)}the others settled by {_settled_by(r)}{_crashing(r)}."
    )
    if c.extremes is not None:
        text += (
            " Extreme-value theory extrapolates the severity at which the "
            f"{c.extremes.n_exceedances} worst events begin to crash (a generalised Pareto law, "
            f"shape {c.extremes.shape:.2f}), and knows nothing of the joint model; it raises an "
            "alarm where its interval at 99 % excludes the answer."
        )
    elif c.ladder is not None:
        text += (
            " Extreme-value theory says nothing here: too few events come near a crash, or so many "
            "crash that none is extreme."
        )
    return (
        text + " The laws below it are in use elsewhere and stand here for comparison only, fitted "
        "to the same events. “Ladder” is the deviance of the severity ladder with its p-value: "
        "a small p-value means that the law is refuted where crashes come from."
        + "".join(f" Could not be computed: {part} ({why})." for part, why in c.failed.items())
    )


def _in_doubt(r: Replay) -> str:
    if not r.n_open:
        return ""
    failed = f" ({r.n_failed} failed)" if r.n_failed else ""
    return f"{r.n_open:,} events left in doubt{failed}, which count by what was learned, "


def _settled_by(r: Replay) -> str:
    return "what the campaign learned" if r.ordered else "the surrogate alone, without an order"


def _crashing(r: Replay) -> str:
    if not r.crashing:
        return ""
    rows = ", ".join(str(row) for row in r.crashing[:MOST_ROWS])
    more = f" and {len(r.crashing) - MOST_ROWS} more" if len(r.crashing) > MOST_ROWS else ""
    several = len(r.crashing) > 1
    return f"; row{'s' if several else ''} {rows}{more} crash{'' if several else 'es'}"


MOST_ROWS = 20


def _amount(value: float) -> str:
    """A number of events, expected: not a whole one where it is small."""
    return count(value) if value >= 100 else plain(value, 3)


def _deviance(ladder: Ladder | None) -> str:
    if ladder is None or len(ladder.levels) < 2 or not ladder.tested:
        return "–"
    return f"{ladder.deviance:,.1f} (p {_p_value(ladder.p_value)})"


def _p_value(p: float) -> str:
    return "< 0.001" if p < 0.001 else f"= {p:.2g}"


def _ladder(ladder: Ladder) -> Sheet:
    between: list[tuple[str, ...]] = [
        (f"{_amount(low)} to {_amount(high)}",)
        for low, high in zip(ladder.low, ladder.high, strict=True)
    ] or [()] * len(ladder.levels)
    columns = zip(ladder.levels, ladder.observed, ladder.expected, between, strict=True)
    rows = [(f"× {x:g}", count(o), _amount(e), *b) for x, o, e, b in columns]
    return Sheet(
        "ladder",
        "Severity ladder",
        "The events made worse by a factor, level by level: how many would crash, by what the "
        "campaign learned (the replay, which simulates, may count one or two others at × 1), and "
        f"how many the traffic model expects among as many. {_tested(ladder)}",
        ("Severity", "Events that crash", "Expected", *("Fits, 5 to 95 %",) * bool(ladder.low)),
        tuple(rows),
    )


def _tested(ladder: Ladder) -> str:
    if not ladder.tested:
        return (
            "Not tested: no event crashes at any level, and the model expects less than one. Does "
            "this severity make a crash likelier?"
        )
    return (
        "The tail of the model is tested where crashes come from: deviance "
        f"{ladder.deviance:,.1f} over {len(ladder.levels)} increments, p "
        f"{_p_value(ladder.p_value)}."
    )


def _tails(tails: tuple[Tail, ...], rivals: tuple[Rival, ...]) -> Sheet:
    rows = []
    for k, tail in enumerate(tails):
        sides = zip(tail.levels, tail.counts, tail.expected, tail.low, tail.high, strict=True)
        for i, (level, n, expected, low, high) in enumerate(sides):
            sign = "≥" if tail.sign > 0 else "≤"
            what = f"{tail.name} {sign} {plain(level, 4)} {tail.unit}".rstrip()
            odd = " (outside)" if tail.outside[i] else ""
            others = [_amount(r.near_misses[k][i]) for r in rivals]
            between = f"{_amount(low)} to {_amount(high)}"
            rows.append((what, count(n), _amount(expected) + odd, between, *others))
    return Sheet(
        "near-misses",
        "Near misses",
        "How many events come at least as near to a crash as a level, and how many the traffic "
        "model expects. “95 % if right” is where the expected number lies for 95 % of recordings "
        "if the model is right: one row in twenty lies outside by chance; two of one quantity, "
        "at 99 %, raise an alarm. TTC is the time to collision, range over closing "
        "speed; DRAC the deceleration that avoids it, closing speed² / (2 range); the minimum gap "
        "is that of the simulated encounter.",
        ("Level", "Events", "Expected", "95 % if right", *(_named(r) for r in rivals)),
        tuple(rows),
    )


def _influence(record: RunRecord, c: Check, found: Influential) -> Sheet:
    axes = variable_axes(record.scenario)
    rows = tuple(
        (str(e.row), *(plain(v, 4) for v in e.situation), f"{100 * e.change:+.1f} %",
         percent(e.variance_share))
        for e in found.events
    )  # fmt: skip
    flat = (
        f" {found.n_flat} directions of the likelihood are flat: their part is unknown."
        if found.n_flat
        else ""
    )
    return Sheet(
        "influence",
        "The events that decide",
        "By the infinitesimal jackknife of the best fit: what the probability would gain if an "
        "event had been recorded twice. The choice of events alone, at this number of components, "
        f"leaves that fit's probability open by a factor {found.factor:.1f} either way; five "
        f"events carry {percent(found.share_of_five)} of the variance. "
        f"{c.n_duplicates:,} of the {c.replay.n_events:,} events equal an earlier one in every "
        f"digit.{flat}",
        ("Row", *(axis.label for axis in axes), "Change", "Share of variance"),
        rows,
    )
