import dataclasses

import numpy as np
import pytest

from crashrate.reports.dominating import dominating_points
from crashrate.reports.figures.learned_set import DominatingPoints, space_plot
from crashrate.reports.learned import learned_set
from crashrate.reports.learned_panels import learned_panels


def traces(plot):
    return {t.name: t for t in plot.figure.data if t.name}


def points(trace):
    return np.column_stack([trace.x, trace.y, trace.z])


def test_points_are_in_physical_units(build):
    record = build()
    learned = learned_set(record)
    found = traces(space_plot(learned, DominatingPoints()))
    v, inv_range, inv_ttc = record.x.T
    physical = np.column_stack([v, inv_ttc / inv_range, 1 / inv_range])
    low, high = np.array([learned.limits(k) for k in range(3)]).T
    inside = ((physical >= low) & (physical <= high)).all(axis=1)
    for name, outcome in (("run: crash", 1), ("run: safe", 0)):
        np.testing.assert_allclose(
            points(found[name]), physical[inside & (record.outcomes == outcome)]
        )
    shown = points(found["minimal crash"])
    assert len(shown) == len(learned.monotone.minimal_crashes)
    np.testing.assert_allclose(shown, learned.monotone.minimal_crashes * [-1, 1, -1])
    scene = space_plot(learned, DominatingPoints()).figure.layout.scene
    assert scene.xaxis.title.text == "v_lead [m/s]"
    assert scene.yaxis.title.text == "closing_speed [m/s]"
    assert scene.zaxis.title.text == "range [m]"


def test_surfaces_are_where_the_labels_change(build):
    learned = learned_set(build())
    found = traces(space_plot(learned, DominatingPoints()))
    for name, label in (("boundary of the inner set", 1), ("boundary of the outer set", 0)):
        surface = found[name]
        x, y = np.meshgrid(surface.x, surface.y)
        z = np.asarray(surface.z)
        seen = np.isfinite(z)
        # u of the third coordinate is -range: step to the dangerous side, or to the safe one
        step = 1e-6 if label == 1 else -1e-6
        u = np.column_stack([-x[seen], y[seen], -z[seen] + step])
        assert seen.any()
        assert (learned.monotone.classify(u) == label).all()
        beyond = u - [0, 0, 2 * step]
        within = (beyond[:, 2] > learned.lower[2]) & (beyond[:, 2] < learned.upper[2])
        assert within.any()
        assert (learned.monotone.classify(beyond[within]) != label).all()


def test_sections_show_what_is_implied(build):
    learned = learned_set(build())
    panel = next(p for p in learned_panels(build()) if p.key == "sections")
    assert len(panel.plots) == 3
    first = panel.plots[0].figure
    heat = first.data[0]
    x, y = np.meshgrid(heat.x, heat.y)
    u = np.column_stack([-x.ravel(), y.ravel(), np.full(x.size, learned.reference[2])])
    np.testing.assert_array_equal(np.ravel(heat.z), learned.monotone.classify(u))
    assert np.all(np.diff(heat.x) > 0)
    words = {a.text for a in first.layout.annotations}
    assert words <= {"implied crash", "implied safe", "undecided"}
    assert words
    assert "range = " in first.layout.title.text


def test_the_reference_is_the_likeliest_crash(build):
    record = build()
    learned = learned_set(record)
    crashes = record.x[record.outcomes == 1]
    likeliest = crashes[record.traffic.log_density(crashes).argmax()]
    np.testing.assert_allclose(learned.reference, learned.order(likeliest[None])[0])


def test_dominating_points_are_the_densest_of_their_component(build):
    record = build()
    learned = learned_set(record)
    s = learned.monotone
    inner = dominating_points(record.traffic, learned.order, s.minimal_crashes)
    outer = dominating_points(record.traffic, learned.order, s.corners)
    assert [p.component for p in inner] == [p.component for p in outer] == [1, 2]
    draws = record.traffic.sample(20_000, 1)
    u = learned.order(draws)
    for points_of, member in ((inner, s.in_inner), (outer, s.in_outer)):
        for p in points_of:
            k = p.component - 1
            off = draws[member(u)] - record.traffic.means[k]
            distance = np.einsum(
                "ni,ij,nj->n", off, np.linalg.inv(record.traffic.covariances[k]), off
            )
            assert p.distance <= np.sqrt(distance.min()) + 1e-9
            assert (learned.order(p.x[None]) >= s.corners - 1e-6).all(axis=1).any()
    assert all(o.distance <= i.distance for i, o in zip(inner, outer, strict=True))


def test_dominating_points_are_left_out_where_level_sets_are_not_flat(build):
    text = (
        '[variables.a]\n[variables.b]\n[derived]\nc = "a * a + b"\n'
        '[risk]\nc = "increasing"\nb = "increasing"\n'
        '[simulator]\nkind = "python"\nfunction = "m:f"\n'
    )
    panel = learned_panels(build(text, danger=lambda x: x[:, 1] - 1))[0]
    assert "Dominating points are not drawn" in panel.caption
    names = {t.name for t in panel.plots[0].figure.data}
    assert "minimal crash" in names
    assert not any("dominating" in n for n in names if n)


def test_two_coordinates_are_drawn_in_the_plane(build, problem):
    text = problem(2, {"x0": "increasing", "x1": "decreasing"})
    record = build(text, danger=lambda x: x[:, 0] - x[:, 1] - 2)
    (panel,) = learned_panels(record)
    found = traces(panel.plots[0])
    learned = learned_set(record)
    shown = np.column_stack([found["minimal crash"].x, found["minimal crash"].y])
    np.testing.assert_allclose(shown, learned.monotone.minimal_crashes * [1, -1])
    assert {"maximal safe point", "corner of the outer set", "dominating point, outer set"} <= set(
        found
    )


def test_of_many_coordinates_those_are_drawn_in_which_the_boundary_varies(build, problem):
    risk = {f"x{k}": "increasing" for k in range(5)}
    record = build(problem(5, risk), danger=lambda x: x[:, 1] + x[:, 2] + x[:, 4] - 2, n=150)
    learned = learned_set(record)
    assert len(learned.axes_to_draw()) == 3
    _, sections = learned_panels(record)
    assert len(sections.plots) == 3
    held = sections.plots[0].figure.layout.title.text
    assert held.count("=") == 3


@pytest.mark.parametrize("direction", ["increasing", "decreasing"])
def test_one_coordinate_is_drawn_as_a_line(build, problem, direction):
    sign = 1 if direction == "increasing" else -1
    record = build(problem(1, {"x0": direction}), danger=lambda x: sign * x[:, 0] - 1)
    (panel,) = learned_panels(record)
    crash, safe = panel.plots[0].figure.layout.shapes
    ends = record.x[record.outcomes == 1, 0]
    assert crash.x0 == (ends.min() if sign > 0 else ends.max())
    assert sign * crash.x1 > (sign * record.x).max()
    assert sign * safe.x0 < sign * crash.x0
    assert sign * safe.x1 < sign * safe.x0


def test_contradictions_are_counted(build):
    record = build(danger=lambda x: np.sin(40 * x[:, 0]))
    text = learned_panels(record)[0].caption
    assert "outcomes contradict the order" in text
    assert "No outcome contradicts" in learned_panels(build())[0].caption


def test_very_many_corners_are_thinned_and_the_legend_says_so(build, problem):
    risk = {f"x{k}": "increasing" for k in range(5)}
    record = build(problem(5, risk), danger=lambda x: x.sum(axis=1) - 2, n=300)
    learned = learned_set(record)
    n = len(learned.monotone.corners)
    assert n > 2000
    found = traces(space_plot(learned, DominatingPoints()))
    assert f"corner of the outer set (2,000 of {n:,})" in found


def test_the_reference_is_a_crash_that_nothing_contradicts(build):
    record = build()
    crashes = np.flatnonzero(record.outcomes == 1)
    likeliest = crashes[np.argsort(-record.traffic.log_density(record.x[crashes]))]
    x, outcomes = record.x.copy(), record.outcomes.copy()
    # the likeliest crash simulated again, this time safe
    x, outcomes = np.vstack([x, x[likeliest[0]]]), np.append(outcomes, 0.0)
    learned = learned_set(dataclasses.replace(record, x=x, outcomes=outcomes))
    u = learned.order(x[likeliest])
    assert not np.array_equal(learned.reference, u[0])
    assert (learned.reference == u).all(axis=1).any()
    assert learned.monotone.classify(learned.reference[None]) == [1]
