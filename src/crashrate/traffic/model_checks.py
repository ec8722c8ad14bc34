"""What a traffic model's numbers must be; each check names what came and where."""

import copy
import json
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from crashrate.errors import InvalidInputError
from crashrate.variables import FloatArray

if TYPE_CHECKING:
    from crashrate.traffic.model import TrafficModel

_WEIGHT_TOLERANCE = 1e-6
_ROUNDING = 1e-12


def checked_shapes(model: "TrafficModel") -> None:
    """Refuse names, shapes, sides and covariances that are not those of a mixture on a box."""
    k, d = len(np.atleast_1d(model.weights)), len(model.names)
    expected = {"weights": (k,), "means": (k, d), "covariances": (k, d, d)}
    expected |= {"lower": (d,), "upper": (d,)}
    for name, shape in expected.items():
        array = getattr(model, name)
        if array.shape != shape or k == 0:
            raise InvalidInputError(
                f"{name}: expected shape {shape} for {k} components of {d} variables "
                f"({', '.join(model.names)}), got {array.shape}."
            )
    for name in ("weights", "means", "covariances"):
        if not np.isfinite(getattr(model, name)).all():
            raise InvalidInputError(f"{name}: expected finite numbers, got nan or inf.")
    _check_sides(model)
    _check_covariances(model.covariances)


def checked_members(model: "TrafficModel") -> None:
    """Refuse members of other variables, another box or other scales."""
    for i, member in enumerate(model.members):
        if not isinstance(member, type(model)):
            raise InvalidInputError(
                f"members[{i}]: expected a traffic model, got {type(member).__name__}."
            )
        for name in ("names", "scales", "lower", "upper"):
            expected, got = getattr(model, name), getattr(member, name)
            if not np.array_equal(expected, got):
                raise InvalidInputError(
                    f"members[{i}]: expected the {name} {expected} of the model, got {got}."
                )


def check_draws(n: object) -> None:
    """Refuse a number of draws that is none."""
    if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or n < 0:
        raise InvalidInputError(f"n: expected a whole number of draws >= 0, got {n!r}.")


def checked_names(given: Iterable[str]) -> tuple[str, ...]:
    """The variables' names, each once."""
    if isinstance(given, str):
        raise InvalidInputError(
            f"names: expected a list of names, such as ['v_lead'], got the text {given!r}."
        )
    names = tuple(given)
    if not names:
        raise InvalidInputError("names: expected at least one variable, got none.")
    for name in names:
        if not isinstance(name, str) or not name.isidentifier():
            raise InvalidInputError(
                f"names: expected Python identifiers such as 'v_lead', got {name!r}."
            )
    if len(set(names)) < len(names):
        raise InvalidInputError(f"names: expected each name once, got {', '.join(names)}.")
    return names


def _check_sides(model: "TrafficModel") -> None:
    for name, low, high in zip(model.names, model.lower, model.upper, strict=True):
        if not low < high:
            raise InvalidInputError(
                f"variable {name!r}: expected lower < upper, got lower = {low} and upper = {high}."
            )
    for name, low, log in zip(model.names, model.lower, model.scales.log, strict=True):
        if log and not low >= 0.0:
            raise InvalidInputError(
                f"variable {name!r}: expected lower >= 0 on a log scale, got lower = {low}."
            )


def _check_covariances(covariances: FloatArray) -> None:
    for k, covariance in enumerate(covariances):
        size = np.sqrt(np.abs(np.diagonal(covariance)))
        if not np.allclose(covariance, covariance.T, rtol=0.0, atol=1e-8 * size.max() ** 2):
            raise InvalidInputError(f"covariance {k}: expected a symmetric matrix.")
        try:
            np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:
            raise InvalidInputError(
                f"covariance {k}: expected a positive definite matrix, got eigenvalues "
                f"{np.linalg.eigvalsh(covariance)}."
            ) from None


def checked_weights(weights: FloatArray) -> FloatArray:
    """Weights that sum to one; only a rounding-sized excess is normalised away.

    Raises
    ------
    InvalidInputError
        If one is negative, or they do not sum to one.
    """
    total = float(weights.sum())
    if not (weights >= 0.0).all() or abs(total - 1.0) > _WEIGHT_TOLERANCE:
        raise InvalidInputError(
            f"weights: expected numbers >= 0 that sum to 1, got {weights} with sum {total:.9g}."
        )
    # Weights that already sum to one keep their bits: a model survives JSON unchanged.
    return weights if abs(total - 1.0) < _ROUNDING else weights / total


def json_provenance(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """A deep copy of `provenance`, refused where JSON cannot hold it."""
    try:
        json.dumps(dict(provenance))
    except (TypeError, ValueError) as error:
        raise InvalidInputError(
            f"provenance: expected a mapping that JSON can hold, got {error}."
        ) from None
    return copy.deepcopy(dict(provenance))
