"""A kilometre of city, far from the origin, and an object of 5 cm in it."""

import numpy as np
import pytest

pytest.importorskip("numba")

from evogs_codec.jobs import Engine
from evogs_codec.jobs import plan as plans
from evogs_codec.jobs.scratch import do_missing
from tools.bench.city import Tiles, city_and_object, encoded

pytestmark = pytest.mark.thorough
N = 3000


def test_an_object_of_5_cm_in_a_kilometre_is_as_exact_as_alone_for_few_more_bytes(tmp_path):
    parts = city_and_object(N, 0, 0.001)
    own = {name: Tiles.of(encoded([part], tmp_path)) for name, part in parts.items()}
    both = Tiles.of(encoded(parts.values(), tmp_path))
    for name, part in parts.items():
        assert np.percentile(own[name].moved(part), 99) < 0.3
        assert np.median(both.moved(part)) < 0.1
        assert np.percentile(both.moved(part), 99) < 0.3
    assert both.n_bytes.sum() < 1.15 * sum(tiles.n_bytes.sum() for tiles in own.values())


def test_an_object_whose_splats_are_a_ten_millionth_of_the_city_stays_itself(tmp_path):
    # In 24 bits a kilometre has steps of 0.1 mm. Splats of 0.03 mm have what adds lack from psi.
    parts = city_and_object(N, 0, None)
    both = Tiles.of(encoded(parts.values(), tmp_path))
    assert np.median(both.moved(parts["object"])) < 0.1
    assert np.percentile(both.moved(parts["object"]), 90) < 0.4
    assert np.percentile(both.moved(parts["city"]), 99) < 0.3


def test_steps_that_tiles_need_coarser_are_the_same_in_any_order_of_completion(
    tmp_path, monkeypatch
):
    """No row is raised beforehand, so that several tiles ask for it at once."""
    errors = []

    def counted(*given):
        errors.append(do_missing(*given))
        return errors[-1]

    monkeypatch.setattr("evogs_codec.jobs.encode.do_missing", counted)
    monkeypatch.setattr(plans, "_raised", lambda steps, _: np.zeros(steps.shape, np.int64))
    parts = city_and_object(900, 0, None).values()
    streams = [encoded(parts, tmp_path, engine) for engine in (None, Engine(workers=2))]
    assert sum(error is not None for error in errors) >= 2
    assert streams[0] == streams[1]
