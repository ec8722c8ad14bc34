import json
from pathlib import Path

import numpy as np
import pytest

from crashrate import datasets

PUBLISHED = Path(__file__).resolve().parents[1] / "../shared/data/published_mixture_k9.json"


def test_published_mixture_is_ready_to_use():
    model = datasets.spmd_mixture()
    assert model.names == ("v_lead", "inv_range", "inv_ttc")
    assert (model.n_components, model.n_variables) == (9, 3)
    assert model.lower.tolist() == [5.0, 1 / 75, 0.0]
    assert model.upper.tolist() == [35.0, np.inf, np.inf]
    assert model.provenance["licence"] == "MIT"
    assert "published fit" in model.provenance["description"]
    # The data behind it: 18 m/s, 1/R and 1/TTC of 0.027 and 0.044.
    np.testing.assert_allclose(model.mean, [18.04, 0.0275, 0.0436], rtol=0.02)


def test_synthetic_events_repeat_and_stay_in_the_box():
    events = datasets.synthetic_spmd_events(500, seed=4)
    assert events.shape == (500, 3)
    assert datasets.spmd_mixture().contains(events).all()
    np.testing.assert_array_equal(events, datasets.synthetic_spmd_events(500, seed=4))
    assert not np.array_equal(events, datasets.synthetic_spmd_events(500, seed=5))
    assert datasets.N_SPMD_EVENTS == 157_757


@pytest.mark.skipif(not PUBLISHED.exists(), reason="the study's own file is not at ../shared/data")
def test_numbers_are_the_studys():
    source = json.loads(PUBLISHED.read_text(encoding="utf-8"))
    model = datasets.spmd_mixture()
    centre, scale = np.array(source["center"]), np.array(source["std"])
    np.testing.assert_array_equal(model.weights, source["weights"])
    np.testing.assert_allclose(model.means, centre + scale * source["means"], rtol=1e-15)
    np.testing.assert_allclose(
        model.covariances, np.array(source["covs"]) * np.outer(scale, scale), rtol=1e-15
    )
