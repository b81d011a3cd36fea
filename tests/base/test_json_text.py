"""JSON that others may have written is read within limits."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np
import pytest

from swerve.base import json_text, store
from swerve.base.store import StoreError
from swerve.constraints.boxes import Box


@pytest.mark.parametrize("text", ["[" + "[]," * 2**21 + "0]", "[" + "1," * 2**22 + "0]"])
def test_a_record_of_too_many_items_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "record.json"
    for many in (text, "]" * (2**22 + 1)):
        path.write_text(f'{{"crc32": "00000000", "data": {many}}}')
        with pytest.raises(StoreError, match=r"not JSON .more than 4,194,304 brackets and com"):
            store.read_json(path)


def test_large_maps_and_lists_of_many_constraints_are_kept() -> None:
    noise = base64.b64encode(np.random.default_rng(0).bytes(2**28 // 8))
    json_text.check(b'{"blocked": "' + noise + b'"}')
    box = json.dumps(Box(x=(1 / 3, 2 / 3), y=(0.1234567, 0.3)).to_json())
    json_text.check(f"[{', '.join([box] * 400_000)}]".encode())


def test_the_ends_of_texts_are_found(tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    deep = "[" * 200
    texts = [deep, deep + "\\", "\\" * 3, '"' + deep, deep + '\\"', "\\\\" + deep, '\\\\"' + deep]
    store.write_json(path, {text + "k": text for text in texts})
    assert list(store.read_json(path).values()) == texts
    with pytest.raises(ValueError, match="nested more than 100 deep"):
        json_text.check(b'["a\\\\", ' + b"[" * 200 + b', "b"')


@pytest.mark.parametrize(
    "text",
    [
        r'{"\ud800": 1}',
        r'["a\uDFFF"]',
        r'["\\\ud800"]',
        r'["\ude00\ud83d"]',
        r'["\ud83d\ud83d\ude00"]',
    ],
)
def test_half_a_character_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ValueError, match=r"\\u[dD]\w{3} is half a character"):
        json_text.parse(text.encode())
    path = tmp_path / "record.json"
    with pytest.raises(ValueError, match="half a character"):
        store.write_json(path, json.loads(text))
    assert not path.exists()


@pytest.mark.parametrize(
    "text", [r'["\ud83d\ude00"]', r'["\\ud800"]', r'["\ud83d\ude00\\ud800"]', '["\U0001f600"]']
)
def test_whole_characters_are_kept(text: str) -> None:
    assert json_text.parse(text.encode()) == json.loads(text)


@pytest.mark.parametrize("data", [b'["\xed\xa0\x80"]', b'["\xff"]', '["a"]'.encode("utf-16")])
def test_what_is_not_utf8_is_refused(data: bytes) -> None:
    with pytest.raises(UnicodeDecodeError):
        json_text.parse(data)


def test_what_could_not_be_read_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limits are those of reading, and the text is that of the file."""
    monkeypatch.setattr(json_text, "MAX_ITEMS", 20)
    for num, is_kept in ((5, True), (30, False)):
        data = list(range(num))
        for name, write in (
            ("a.json", lambda path, data=data: store.write_json(path, data)),
            ("a.stored", lambda path, data=data: store.write(path, "a", 1, {"data": data}, {})),
        ):
            path = tmp_path / f"{num}.{name}"
            if is_kept:
                write(path)
            else:
                with pytest.raises(ValueError, match="more than 20 brackets and commas"):
                    write(path)
            assert path.exists() == is_kept
    assert store.read_json(tmp_path / "5.a.json") == [0, 1, 2, 3, 4]
    assert store.open_file(tmp_path / "5.a.stored", "a", 1).header == {"data": [0, 1, 2, 3, 4]}
