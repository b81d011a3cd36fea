"""Records in JSON: read back, refused where they are altered."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.stored_files import flips, refuses

from swerve.base import store

json_data = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=10,
)


@given(data=json_data)
def test_round_trip_of_records(tmp_path_factory: pytest.TempPathFactory, data: Any) -> None:
    path = tmp_path_factory.getbasetemp() / "record.json"
    store.write_json(path, data)
    back = store.read_json(path)
    assert back == data
    assert json.dumps(back) == json.dumps(data)  # 1 is not 1.0, nor True


def test_an_altered_or_cut_record_is_refused_or_harmless(tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    data = {"rate": 15e99, "small": -1e-7, "text": "Swérve", "list": [1, True, None]}
    store.write_json(path, data)
    content = path.read_bytes()
    variants = [content[:length] for length in range(len(content) - 1)] + list(flips(content))

    def read_same(path: Path) -> None:
        assert json.dumps(store.read_json(path)) == json.dumps(data)

    refused = 0
    for variant in variants:
        path.write_bytes(variant)
        refused += refuses(read_same, path)
    assert refused > 0.8 * len(variants)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", r"record.json: cut short or altered, not JSON .*left as it was; copy it again"),
        ("[]", r"not a Swerve file: expected a JSON object.*give a file that swerve wrote"),
        ("{}", r"not a Swerve record, or altered: expected the keys crc32 and data"),
        ('{"crc32": "00000000", "data": 1}', r"its checksum does not match its data"),
        ('{"crc32": "00000000", "data": 1e999}', r"its checksum does not match its data"),
    ],
)
def test_refuses_other_records(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "record.json"
    path.write_text(content)
    with pytest.raises(store.StoreError, match=message):
        store.read_json(path)
    assert path.read_text() == content


def test_a_record_that_is_not_json_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    store.write_json(path, [1])
    with pytest.raises(ValueError, match="not JSON compliant"):
        store.write_json(path, float("inf"))
    with pytest.raises(TypeError, match="not JSON serializable"):
        store.write_json(path, {1, 2})
    assert store.read_json(path) == [1]
