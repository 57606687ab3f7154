from __future__ import annotations

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellwright.errors import InvalidInputError
from storage.keys import canonical_json, is_hash, recipe_key

DIGEST = hashlib.sha256(b"an input").hexdigest()
OTHER = hashlib.sha256(b"another").hexdigest()

plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.text(), plain, max_size=4))
def test_the_key_does_not_depend_on_the_order_of_names(params: dict[str, object]) -> None:
    turned = dict(reversed(params.items()))
    assert recipe_key("s", 1, params, {}) == recipe_key("s", 1, turned, {})


def test_every_part_of_the_recipe_changes_the_key() -> None:
    keys = {
        recipe_key("s", 1, {"a": 1}, {"x": DIGEST}),
        recipe_key("t", 1, {"a": 1}, {"x": DIGEST}),
        recipe_key("s", 2, {"a": 1}, {"x": DIGEST}),
        recipe_key("s", 1, {"a": 2}, {"x": DIGEST}),
        recipe_key("s", 1, {"a": 1}, {"y": DIGEST}),
        recipe_key("s", 1, {"a": 1}, {"x": OTHER}),
        recipe_key("s", 1, {"a": 1}, {"x": [DIGEST]}),
        recipe_key("s", 1, {"a": 1}, {"x": None}),
        recipe_key("s", 1, {"a": 1}, {}),
    }
    assert len(keys) == 9
    assert all(is_hash(key) for key in keys)


def test_the_order_of_several_inputs_counts() -> None:
    assert recipe_key("s", 1, {}, {"x": [DIGEST, OTHER]}) != recipe_key("s", 1, {}, {"x": [OTHER, DIGEST]})
    assert recipe_key("s", 1, {}, {"x": [DIGEST, OTHER]}) == recipe_key("s", 1, {}, {"x": (DIGEST, OTHER)})


def test_the_key_is_the_hash_of_the_documented_text() -> None:
    text = '{"inputs":{"x":"' + DIGEST + '"},"params":{"density_per_m2":1000.0},"stage":"sample_surface","version":3}'
    expected = hashlib.sha256(text.encode()).hexdigest()
    assert recipe_key("sample_surface", 3, {"density_per_m2": 1000.0}, {"x": DIGEST}) == expected


@pytest.mark.parametrize("value", [float("nan"), float("inf"), np.float32(1), object(), {1, 2}])
def test_parameters_without_a_json_form_are_refused(value: object) -> None:
    with pytest.raises(InvalidInputError, match="cannot be keyed"):
        canonical_json({"a": value})


@pytest.mark.parametrize("digest", ["", "abc", DIGEST.upper(), DIGEST + "\n", "../" + DIGEST[3:], 7])
def test_an_input_that_is_no_digest_is_refused(digest: object) -> None:
    with pytest.raises(InvalidInputError, match="not a digest"):
        recipe_key("s", 1, {}, {"x": [digest]})  # type: ignore[list-item]
