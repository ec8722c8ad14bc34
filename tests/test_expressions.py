import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crashrate.errors import ExpressionError, InvalidInputError
from crashrate.expressions import Expression, HalfSpace

NAMES = ("v_lead", "inv_range", "inv_ttc")
LOWER = np.array([5.0, 1.0 / 75.0, 0.0])
UPPER = np.array([35.0, np.inf, np.inf])


def draw(n=400, seed=0):
    rng = np.random.default_rng(seed)
    return LOWER + rng.exponential([10.0, 0.1, 0.3], size=(n, 3))


V, R, T = (np.array(column) for column in draw().T)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1 / inv_range", 1 / R),
        ("inv_ttc / inv_range", T / R),
        ("-v_lead + 2 * inv_ttc ** 2 - +3", -V + 2 * T**2 - 3),
        ("exp(-inv_ttc) + log(v_lead) * sqrt(v_lead)", np.exp(-T) + np.log(V) * V**0.5),
        ("max(v_lead, 10, 20 * inv_ttc)", np.maximum(np.maximum(V, 10), 20 * T)),
        ("min(abs(v_lead - 12),\n 3)", np.minimum(np.abs(V - 12), 3)),
        ("v_lead ** (1 / 2)", np.sqrt(V)),
        ("2", np.full(len(V), 2.0)),
    ],
)
def test_values_are_those_of_the_formula(text, expected):
    values = Expression(text, NAMES)(draw())
    assert values.shape == expected.shape
    assert values.dtype == np.float64
    np.testing.assert_allclose(values, expected, rtol=1e-14)


def test_division_by_zero_is_infinite_and_undefined_is_nan():
    x = np.array([[0.0, 1.0], [0.0, -1.0], [0.0, 0.0]])
    np.testing.assert_array_equal(Expression("b / a", ("a", "b"))(x), [np.inf, -np.inf, np.nan])
    assert math.isnan(Expression("log(b)", ("a", "b"))(x)[1])


def test_empty_table_gives_no_values():
    assert Expression("a + 1", ("a",))(np.empty((0, 1))).shape == (0,)


def test_result_is_not_a_view_of_the_rows():
    x = draw(3)
    Expression("v_lead", NAMES)(x)[:] = 0.0
    assert x[:, 0].all()


def test_wrong_number_of_columns_names_the_columns():
    with pytest.raises(InvalidInputError, match=r"\(n, 3\).*v_lead, inv_range, inv_ttc.*\(4, 2\)"):
        Expression("v_lead", NAMES)(np.zeros((4, 2)))


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("1 / inv_rang", "did you mean 'inv_range'"),
        ("1 /", "it ends too early"),
        ("1 / (", "at '('"),
        ("__import__('os').system('true')", "refused"),
        ("__import__('os')", "unknown function '__import__'"),
        ("sqr(v_lead)", "did you mean 'sqrt'"),
        ("v_lead.real", "'v_lead.real' is refused"),
        ("v_lead > 3", "'v_lead > 3' is refused"),
        ("v_lead if 1 else 2", "refused"),
        ("[v_lead]", "refused"),
        ("v_lead[0]", "refused"),
        ("(lambda: 1)()", "refused"),
        ("True", "'True' is refused"),
        ("1j", "'1j' is refused"),
        ("'a'", "refused"),
        ("v_lead // 2", "refused"),
        ("v_lead % 2", "refused"),
        ("~v_lead", "refused"),
        ("not v_lead", "refused"),
        ("v_lead ** inv_ttc", "'inv_ttc' is refused: an exponent must be a constant"),
        ("9 ** 9 ** 9", "at most 100"),
        ("v_lead ** 1e300", "'1e300' is refused"),
        ("v_lead ** (0/0)", "at most 100"),
        ("1e999", "too large"),
        ("1" + "0" * 400, "too large"),
        ("exp(v_lead, 2)", "exp takes one argument, got 2"),
        ("max(v_lead)", "max takes two or more arguments, got 1"),
        ("max(*v_lead)", "two or more arguments"),
        ("max(v_lead, *v_lead)", "refused"),
        ("exp(x=v_lead)", "refused"),
        ("(y := 3)", "refused"),
        ("1if 2else 3", "not arithmetic"),
        ("", "1 to 1000 characters, got 0"),
        ("1 +" * 500 + "1", "1 to 1000 characters"),
        ("-" * 900 + "1", ""),
        ("(" * 300 + "1" + ")" * 300, ""),
        ("exp(" * 60 + "1" + ")" * 60, "deeper than 50"),
        ("v_lead \0", ""),
        ("import os", "not arithmetic"),
        ("1; 2", "not arithmetic"),
    ],
)
def test_everything_else_is_refused_and_quoted(text, part):
    with pytest.raises(ExpressionError) as caught:
        Expression(text, NAMES)
    assert part in str(caught.value)
    assert text[:10].strip() in str(caught.value) or "\0" in text


def test_text_that_is_not_text_is_refused():
    with pytest.raises(ExpressionError, match="got 3"):
        Expression(3, NAMES)


@settings(max_examples=300, deadline=None)
@given(st.text(alphabet="ab01.+-*/()e ,<>=[]{}'\"\\_:;!@#\n", max_size=40))
def test_any_text_is_an_expression_or_an_expression_error(text):
    try:
        expression = Expression(text, ("a", "b"))
    except ExpressionError:
        return
    assert expression(np.ones((2, 2))).shape == (2,)


def test_equal_expressions_are_one_value_and_survive_pickling():
    derived = {"range": Expression("1 / inv_range", NAMES)}
    a = Expression.parse("inv_ttc * range", NAMES, derived)
    b = Expression.parse("inv_ttc * range", list(NAMES), dict(derived))
    assert a == b
    assert hash(a) == hash(b)
    assert a != Expression.parse("range * inv_ttc", NAMES, derived)
    copy = pickle.loads(pickle.dumps(a))  # noqa: S301
    assert copy == a
    np.testing.assert_array_equal(copy(draw()), a(draw()))


def test_derived_quantities_may_use_earlier_ones():
    derived = {"range": Expression("1 / inv_range", NAMES)}
    derived["closing_speed"] = Expression.parse("inv_ttc * range", NAMES, derived)
    ego = Expression.parse("v_lead + closing_speed", NAMES, derived)
    x = draw()
    np.testing.assert_allclose(ego(x), x[:, 0] + x[:, 2] / x[:, 1], rtol=1e-14)
    with pytest.raises(ExpressionError, match="did you mean 'closing_speed'"):
        Expression.parse("closing_sped", NAMES, derived)


def test_derived_quantity_may_not_take_a_variables_name_or_other_columns():
    with pytest.raises(ExpressionError, match="'v_lead': the name is taken"):
        Expression.parse("1", NAMES, {"v_lead": Expression("2", NAMES)})
    with pytest.raises(ExpressionError, match="got one on"):
        Expression.parse("1", NAMES, {"range": Expression("2", ("a",))})


def test_written_out_size_is_bounded():
    derived = {"a0": Expression("v_lead", NAMES)}

    def square_again():
        for k in range(40):
            derived[f"a{k + 1}"] = Expression.parse(f"a{k} * a{k}", NAMES, derived)

    with pytest.raises(ExpressionError, match="longer than 2000"):
        square_again()


LINEAR_FRACTIONAL = [
    "v_lead",
    "-v_lead",
    "1 / inv_range",
    "-(1 / inv_range)",
    "inv_ttc / inv_range",
    "inv_ttc * (1 / inv_range)",
    "(1 / inv_range) * inv_ttc * 3.6",
    "v_lead + 2 * inv_ttc - 4 / 3",
    "inv_range ** -1",
    "3 - inv_ttc / (2 * inv_range)",
    "v_lead / inv_range + inv_ttc / (3 * inv_range) - 2",
    "(v_lead - 1) / (inv_range + inv_ttc)",
    "inv_ttc / -inv_range",
    "1 / (inv_ttc / inv_range)",
    "inv_ttc * max(1, 2) / inv_range ** 1",
    "v_lead ** 0 * inv_ttc",
    "1 / inv_ttc",
]


@pytest.mark.parametrize("text", LINEAR_FRACTIONAL)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_half_space_holds_the_rows_at_or_above_the_level(text, sign):
    expression = Expression(text, NAMES)
    x = draw()
    values = sign * expression(x)
    for level in np.quantile(values, [0.1, 0.5, 0.9]):
        between = level + 1e-9 * abs(level)  # not at a row: ties may fall on either side
        half_space = expression.half_space(between, sign, LOWER, UPPER)
        assert isinstance(half_space, HalfSpace)
        np.testing.assert_array_equal(half_space.contains(x), values >= between)


@pytest.mark.parametrize(
    "text",
    [
        "v_lead * inv_ttc",
        "v_lead ** 2",
        "sqrt(v_lead)",
        "abs(v_lead)",
        "max(v_lead, inv_ttc)",
        "v_lead + 1 / inv_range",
        "1 / inv_range + 1 / inv_ttc",
        "1 / (v_lead - 20)",  # changes sign in the box
        "1 / (inv_ttc - inv_range)",
        "v_lead / 0",
        "1 / (v_lead - v_lead)",
        "(1 / 0) * v_lead",
    ],
)
def test_what_is_not_linear_fractional_of_one_sign_has_no_half_space(text):
    assert Expression(text, NAMES).half_space(0.3, 1.0, LOWER, UPPER) is None


def test_half_space_of_the_closing_speed_is_the_one_in_closed_form():
    closing = Expression("inv_ttc / inv_range", NAMES).half_space(7.0, 1.0, LOWER, UPPER)
    normal, offset = closing
    np.testing.assert_array_equal(normal, [0.0, -7.0, 1.0])
    assert offset == 0.0
    assert not closing.normal.flags.writeable
    near = Expression("1 / inv_range", NAMES).half_space(-4.0, -1.0, LOWER, UPPER)  # range <= 4
    np.testing.assert_allclose(near.normal / near.offset, [0.0, 4.0, 0.0])


def test_sign_of_the_denominator_needs_the_box():
    expression = Expression("inv_ttc / inv_range", NAMES)
    assert expression.half_space(1.0) is None
    assert Expression("2 * v_lead", NAMES).half_space(1.0) is not None


def test_half_space_refuses_a_level_or_box_that_means_nothing():
    expression = Expression("v_lead", NAMES)
    with pytest.raises(InvalidInputError, match="finite level"):
        expression.half_space(np.inf)
    with pytest.raises(InvalidInputError, match="sign"):
        expression.half_space(1.0, 2.0)
    with pytest.raises(InvalidInputError, match=r"shape \(3,\)"):
        expression.half_space(1.0, 1.0, [0.0, 1.0])


@settings(max_examples=200, deadline=None)
@given(
    st.recursive(
        st.sampled_from(["a", "b", "2", "0.5", "(-3)"]),
        lambda inner: st.tuples(inner, st.sampled_from("+-*/"), inner).map(
            lambda t: f"({t[0]} {t[1]} {t[2]})"
        ),
        max_leaves=6,
    ),
    st.floats(-3.0, 3.0),
)
def test_whenever_there_is_a_half_space_it_is_the_right_one(text, level):
    expression = Expression(text, ("a", "b"))
    half_space = expression.half_space(level, 1.0, [0.5, 0.5], [4.0, np.inf])
    if half_space is None:
        return
    x = 0.5 + 3.5 * np.random.default_rng(1).random((100, 2))
    values = expression(x)
    clear = np.abs(values - level) > 1e-9 * (1.0 + np.abs(values))
    np.testing.assert_array_equal(half_space.contains(x)[clear], (values >= level)[clear])
